"""Scenario files: one YAML file is one question, validated into a frozen description.

``load`` reads and checks; errors name file, line and key. A scenario never executes code: YAML is safe-loaded, processes and built-in
trajectories are registered names, numbers carry units (``0.032 deg/s/sqrt(Hz)``) and are converted here, once.
"""

from insemu.scenario.design import AxisSource, Design, DesignOptions, GyroSource
from insemu.scenario.designs import shipped_designs
from insemu.scenario.fields import EffectList, Section
from insemu.scenario.files import code_version, digest, load, resolve_path, schema, validated
from insemu.scenario.schema import (
    MAX_REALIZATIONS,
    FitSource,
    Gnss,
    Initial,
    NonHolonomic,
    Published,
    RandomOutages,
    RecordedSignal,
    Scenario,
    SensorModels,
    TrajectorySource,
    Truth,
    VehicleKeys,
)
from insemu.scenario.shipped import located, shipped_scenarios
from insemu.scenario.starting import SENSOR, Spoken, Wish, copy_shipped, first_scenario, motion_of
from insemu.scenario.structure import state_names, structures
from insemu.scenario.swept import with_changes

__all__ = [
    "MAX_REALIZATIONS",
    "SENSOR",
    "AxisSource",
    "Design",
    "DesignOptions",
    "EffectList",
    "FitSource",
    "Gnss",
    "GyroSource",
    "Initial",
    "NonHolonomic",
    "Published",
    "RandomOutages",
    "RecordedSignal",
    "Scenario",
    "Section",
    "SensorModels",
    "Spoken",
    "TrajectorySource",
    "Truth",
    "VehicleKeys",
    "Wish",
    "code_version",
    "copy_shipped",
    "digest",
    "first_scenario",
    "load",
    "located",
    "motion_of",
    "resolve_path",
    "schema",
    "shipped_designs",
    "shipped_scenarios",
    "state_names",
    "structures",
    "validated",
    "with_changes",
]
