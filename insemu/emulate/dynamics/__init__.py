"""What a vehicle does next to its path: it shakes, pitches and slips, as spectra, lines and slow processes of one file say."""

from insemu.emulate.dynamics.blocks import Mount
from insemu.emulate.dynamics.files import MovingVehicle, read_vehicle, vehicle_text
from insemu.emulate.dynamics.levels import Levels
from insemu.emulate.dynamics.presets import preset_file, presets
from insemu.emulate.dynamics.shaken import BodyMotion, Moving, shaken
from insemu.emulate.dynamics.slip import Slip
from insemu.emulate.dynamics.slow import SlowProcess
from insemu.emulate.dynamics.spectrum import Line, MotionSpectrum, Regime, weights

__all__ = [
    "BodyMotion",
    "Levels",
    "Line",
    "MotionSpectrum",
    "Mount",
    "Moving",
    "MovingVehicle",
    "Regime",
    "Slip",
    "SlowProcess",
    "preset_file",
    "presets",
    "read_vehicle",
    "shaken",
    "vehicle_text",
    "weights",
]
