"""What the user believes: noise per axis, effects that are known, GNSS noise, initial uncertainties, and how the IMU sits in the vehicle."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from insemu import yamlfile
from insemu.effects import EffectUse
from insemu.errors import InputError
from insemu.noise import DR, SIN, NoiseModel, load
from insemu.prepared import Drive, Stated, prepared
from insemu.records import Recording
from insemu.rotation import dcm_from_rpy
from insemu.scenario import EffectList, Gnss, Initial, NonHolonomic, Scenario, Section, SensorModels, validated
from insemu.scenario import load as load_scenario


@dataclass(frozen=True)
class Nominal:
    """The belief that a recording is held against.

    Parameters
    ----------
    beliefs : mapping of axis to NoiseModel
        ``gyro_x`` ... ``accel_z``, or a column's own name.
    gnss, initial
        Sections of a scenario; defaults where the file does not say.
    effects : tuple of EffectUse
        What is known besides noise; it is taken off the recording before anything is looked for.
    vehicle : NonHolonomic, optional
        How the IMU sits in a vehicle that moves where it points; ``None``: nothing is known of that.
    filled : tuple of str
        Effects whose samples are filled in, and whose beliefs hold what that leaves open, as those of a filter that was refined do.
    mounting : (3,) tuple
        Angles of the IMU in the body, rad, where the recording and the lever arm are in the IMU's own axes; zero where they are in the body's.
    raw : mapping
        The file as it was read, for writing the refined one.
    kind : str
        ``scenario``, ``belief`` or ``noise`` (a file of :func:`insemu.noise.save`).
    """

    beliefs: dict[str, NoiseModel]
    gnss: Gnss = field(default_factory=Gnss)
    initial: Initial = field(default_factory=Initial)
    raw: Mapping[str, Any] = field(default_factory=dict)
    kind: str = "belief"
    source: str = ""
    effects: tuple[EffectUse, ...] = ()
    vehicle: NonHolonomic | None = None
    filled: tuple[str, ...] = ()
    mounting: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def parted(self) -> Nominal:
        """Lines and ramps, which no spectrum and no covariance holds, moved from the noise models to the known effects."""
        beliefs: dict[str, NoiseModel] = {}
        effects = list(self.effects)
        for name, model in self.beliefs.items():
            sensor, _, axis = name.rpartition("_")
            known = [p for p in model if isinstance(p, SIN | DR)] if sensor in ("gyro", "accel") else []
            for p in known:
                value = p.parameters["alpha"] if isinstance(p, SIN) else p.parameters["R"]
                size = tuple(value if a == axis else 0.0 for a in "xyz")
                if isinstance(p, SIN):
                    numbers = {"amplitude": size, "frequency": (p.parameters["f"],)}
                    effects.append(EffectUse("vibration_line", sensor, numbers))
                else:
                    effects.append(EffectUse("ramp", sensor, {"R": size}))
            rest = tuple(p for p in model if p not in known)
            beliefs[name] = NoiseModel(rest) if known and rest else model
        return replace(self, beliefs=beliefs, effects=tuple(effects))

    def stated(self) -> Stated:
        """What the model states of a drive in the axes of the IMU; what is wrong with its samples and velocities is for the search to find."""
        g, C = self.gnss, dcm_from_rpy(np.array(self.mounting))
        sigmas = {k: getattr(g, k) for k in ("position_sigma", "velocity_sigma") if k in g.model_fields_set}
        believed = g.velocity_sigma is not None
        return Stated(
            C @ np.array(g.lever_arm), self.mounting, with_velocity=believed, corrected=False, shortest=0.0, **sigmas
        )

    def on(self, recording: Recording) -> tuple[Nominal, Drive]:
        """The model with the standard deviations that neither it nor a recording states, and the drive that the recording makes.

        Parameters
        ----------
        recording : Recording
            With fixes; looked at as it was measured.

        Raises
        ------
        InputError
            See :func:`insemu.prepared.prepared`.
        """
        drive = prepared(recording.as_measured(), self.stated())
        fixes, found = drive.gnss, {}
        for what, sigma in (("position", fixes.pos_std_ned), ("velocity", fixes.vel_std_ned)):
            if {"position": "positions", "velocity": "velocities"}[what] in drive.assumed and sigma is not None:
                found[f"{what}_sigma"] = tuple(sigma[0].tolist())
        return replace(self, gnss=self.gnss.model_copy(update=found)), drive

    @property
    def known_levels(self) -> NDArray[np.float64]:
        """Known levels of the fixes over the stated ones, (6,): position, then velocity, north, east, down."""
        out = np.ones(6)
        for use in self.effects:
            if use.effect.does("true_sigma"):
                out[:3] = use.effect.true_sigma(use, "position", out[:3])
                out[3:] = use.effect.true_sigma(use, "velocity", out[3:])
        return out


#: The design that a refined scenario has beside its own.
REFINED = "refined"


def load_nominal(path: str | Path) -> Nominal:
    """Read a nominal model.

    Three kinds of file are understood: a scenario, a short file with the keys ``belief`` (noise per axis as in a scenario) and optionally
    ``effects``, ``gnss``, ``initial`` and ``vehicle``, and a noise-model file of ``insemu fit``. Of a scenario its ``truth`` (models and effects)
    is what is believed of the sensor; one of a recording has none, and its design ``refined``, else the first one in numbers, stands for it.

    Raises
    ------
    InputError
        None of them, naming file and key.
    """
    path = Path(path)
    document = yamlfile.read(path)
    raw = document.data
    if not isinstance(raw, dict):
        raise InputError("expected a scenario, a belief file or a noise-model file (a YAML mapping)", where=str(path))
    if "axes" in raw:
        return Nominal(load(path), raw=raw, kind="noise", source=str(path))
    if "belief" in raw:
        return _belief_file(document)
    return _scenario(load_scenario(path), raw, path)


class BeliefFile(Section):
    """The keys of a belief file."""

    belief: SensorModels
    effects: EffectList = ()
    gnss: Gnss = Gnss()
    initial: Initial = Initial()
    vehicle: NonHolonomic | None = None
    title: str = ""
    notes: str = ""


def _belief_file(document: yamlfile.Document) -> Nominal:
    held = validated(BeliefFile, document)
    beliefs = held.belief.models()
    if not beliefs:
        raise InputError(
            "'belief' names no axis; expected gyro, accel or single axes such as gyro_x", where=document.name
        )
    raw, vehicle = document.data, held.vehicle
    return Nominal(beliefs, held.gnss, held.initial, raw, "belief", document.name, held.effects, vehicle)


def _scenario(scenario: Scenario, raw: dict[str, Any], path: Path) -> Nominal:
    models = scenario.truth.models() if scenario.truth is not None else {}
    effects = scenario.truth.effects if scenario.truth is not None else ()
    vehicle, filled = None, tuple[str, ...]()
    if scenario.recording is not None:
        source = scenario.recording
        held = {
            name: {axis: m for axis, m in design.sources().items() if isinstance(m, NoiseModel)}
            for name, design in scenario.designs.items()
        }
        # what an earlier gap refined is what is believed now
        name = next((n for n in (REFINED, *held) if len(held.get(n, ())) == 6), None)
        if name is None:
            raise InputError(
                "every design is fitted or read from a file, expected one in numbers: a gap needs models to hold a recording against",
                where=f"{path}: designs",
            )
        models, design = held[name], scenario.designs[name]
        effects = (*source.known, *design.options.compensate)
        filled = tuple(use.id for use in effects if "filled" in use.effect.traits)
        if source.imu_time_offset:
            effects = (EffectUse("imu_gnss_time_offset", "imu", {"offset": (source.imu_time_offset,)}), *effects)
        vehicle = source.vehicle
        if any(source.mounting):
            effects = (EffectUse("mounting", "imu", {"rpy": source.mounting}), *effects)
    if not models:
        raise InputError("no noise models as truth; a gap needs models to hold a recording against", where=str(path))
    return Nominal(models, scenario.gnss, scenario.initial, raw, "scenario", str(path), effects, vehicle, filled)
