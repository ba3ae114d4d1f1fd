"""Effects that a sensor, a clock, a receiver or a model of motion may have: one object each, and the one list of them."""

from insemu.effects.base import CROSS as CROSS
from insemu.effects.base import EFFECTS as EFFECTS
from insemu.effects.base import SIGNAL_UNITS as SIGNAL_UNITS
from insemu.effects.base import Effect as Effect
from insemu.effects.base import EffectParameter as EffectParameter
from insemu.effects.base import EffectUse as EffectUse
from insemu.effects.base import Family as Family
from insemu.effects.base import Sensor as Sensor
from insemu.effects.base import effect_of as effect_of
from insemu.effects.base import markdown_table as markdown_table
