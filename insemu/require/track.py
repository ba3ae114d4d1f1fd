"""A track prepared for any number of sensors: what unit noise of every axis does between two fixes, kept by digest."""

from __future__ import annotations

import hashlib
import io
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from insemu.compiled import own_folder
from insemu.errors import InputError
from insemu.evaluate import EmulatedWorld
from insemu.filters import AIDS, AidUse, Intervals, aid_jacobian, basis
from insemu.lanes import LANES, empty, lanes_of
from insemu.records import AidRecord
from insemu.require.kernel import FIX_ROWS, Driven, Nodes, outages
from insemu.require.sensors import Sensor, States, states_of
from insemu.scenario import Scenario, code_version
from insemu.strapdown import NavState, mechanize_array
from insemu.whole import put

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

#: Outages of a track, the time in which a filter settles before the first, s, and the longest part of a track that is flown, s.
STARTS, SETTLING, LONGEST = 6, 120.0, 900.0
#: Below this speed a vehicle stands, m/s; a filter that knows it takes its velocity for zero to so much, m/s.
STANDS, STANDSTILL = 0.05, 0.01
#: Answers of earlier calls that are kept, files.
MOST_KEPT = 200
#: Rate of the aids, Hz.
AID_RATE = 1.0


@dataclass(frozen=True)
class Track:
    """A track cut at its fixes, with k intervals.

    Parameters
    ----------
    t : (k + 1,) array
        Nodes, s from the start.
    rows : (k + 1,) array of int
        Rows of the IMU at the nodes.
    dt : float
        Sampling interval of the IMU, s.
    F, gain, rates
        Of the intervals (:class:`insemu.filters.Intervals`), and what the axes measure on the same polynomials.
    fixed : (k + 1,) array of bool
        Nodes with a fix.
    sigma : (6,) array
        Standard deviations of a fix, m and m/s; infinite where there is none.
    start : (9,) array
        Standard deviations of the navigation errors at the start.
    motion : (k + 1, 10) array
        Navigation state at the nodes.
    """

    t: Array
    rows: Ints
    dt: float
    F: Array
    gain: Array
    rates: Array
    fixed: NDArray[np.bool_]
    sigma: Array
    start: Array
    motion: Array

    @classmethod
    def of(cls, scenario: Scenario, file: str | Path | None = None) -> Track:
        """The track, fixes and start of a scenario; its sensors, designs and outages do not count.

        Raises
        ------
        InputError
            A recording, or a trajectory that cannot be flown.
        """
        world = EmulatedWorld(scenario, file)
        imu = world.imu.as_increments()
        nav = mechanize_array(imu, NavState.of(world.reference), gravity=world.gravity)
        fixes = world.recording(0, ideal=True).gnss
        assert fixes is not None
        at = np.searchsorted(imu.t, fixes.t - 1e-6).clip(0, len(imu) - 1)
        cut = Intervals.of(imu, nav, world.gravity, at.astype(np.int64))
        gnss = scenario.gnss
        sigma = np.concatenate([gnss.position_sigma, gnss.velocity_sigma or (np.inf,) * 3])
        rates = cut.projected(np.hstack([imu.gyro, imu.accel]) / imu.widths(0.0))
        return cls(
            imu.t[cut.nodes] - imu.t[0], cut.nodes, imu.dt, cut.F, cut.gain, rates, np.isin(cut.nodes, at[at > 0]), sigma,
            scenario.initial.sigma.to_array(), nav[cut.nodes],
        )  # fmt: skip

    def starts(self, longest: float, count: int = STARTS) -> Ints:
        """Nodes at which outages of so many seconds begin, evenly along the track after the filter has settled.

        Raises
        ------
        InputError
            A track that is too short.
        """
        room = float(self.t[-1]) - longest
        if room < min(SETTLING, longest):
            raise InputError(
                f"the track lasts {self.t[-1]:.0f} s, expected {longest + min(SETTLING, longest):.0f} s or more for an outage of {longest:g} s"
            )
        wanted = np.linspace(min(SETTLING, 0.5 * room), room, count)
        fixed = np.flatnonzero(self.fixed)
        at = fixed[np.searchsorted(self.t[fixed], wanted + 1e-6, side="right") - 1]
        return np.unique(at).astype(np.int64)

    def measurements(self, aids: Mapping[str, AidUse | None]) -> tuple[Array, Array]:
        """Rows of fixes and aids at all nodes: (k + 1, w, 9) and their variances (k + 1, w); an aid of None is a known standstill."""
        nodes = self.t.size
        H, var = [np.tile(np.eye(FIX_ROWS, 9), (nodes, 1, 1))], [np.where(self.fixed[:, None], self.sigma**2, np.inf)]
        whole = np.abs(self.t * AID_RATE - np.round(self.t * AID_RATE)) < 1e-6 * AID_RATE
        whole[0] = False
        for use in aids.values():
            if use is None:
                stands = whole & (np.linalg.norm(self.motion[:, 3:6], axis=1) < STANDS)
                H.append(np.tile(np.eye(3, 9, 3), (nodes, 1, 1)))
                var.append(np.where(stands[:, None], STANDSTILL**2, np.inf) * np.ones(3))
                continue
            w = len(use.sigma)
            record = AidRecord(use.aid.name, np.ones(1), np.zeros((1, w)), np.ones((1, w)), use.settings)
            H.append(np.stack([aid_jacobian(record, nav) for nav in self.motion]))
            var.append(np.where(whole[:, None], np.array(use.sigma) ** 2, np.inf))
        return np.concatenate(H, axis=1), np.concatenate(var, axis=1)

    def responses(self, states: States) -> tuple[Array, ...]:
        """What the states of sensors, and white noise of the axes, do over every interval: ``E, D, N, C, R`` of :func:`outages`."""
        k, groups = len(self.F), len(states.decay)
        m = 6 * (groups + states.scaled)
        E, D = np.zeros((k, 9, m)), np.ones((k, m))
        N, C, R = np.zeros((k, m + 6, 9, 9)), np.zeros((k, m, 9)), np.zeros((k, m))
        lengths = np.diff(self.rows)
        for length in np.unique(lengths):
            which, U = np.flatnonzero(lengths == length), basis(int(length))
            gain = self.gain[which].transpose(0, 2, 1, 3)  # interval, axis, error, polynomial
            N[which, m:] = gain @ gain.transpose(0, 1, 3, 2)
            for g, a in enumerate(states.decay):
                reach, power = np.empty_like(U), a ** np.arange(length - 1, -1, -1.0)
                last = np.zeros(U.shape[1])
                for j in range(length - 1, -1, -1):
                    last = U[j] + a * last
                    reach[j] = last
                at = slice(6 * g, 6 * g + 6)
                E[which, :, at] = (gain @ (a * reach[0])).transpose(0, 2, 1)
                N[which, at] = gain @ (reach.T @ reach) @ gain.transpose(0, 1, 3, 2)
                C[which, at], R[which, at], D[which, at] = gain @ (power @ reach), power @ power, a**length
        if states.scaled:
            E[:, :, m - 6 :] = np.einsum("krap,kap->kra", self.gain, self.rates)
        return E, D, N, C, R

    def covariances(
        self, sensors: Sequence[Sensor], seconds: Sequence[float], aids: Mapping[str, AidUse | None] | None = None
    ) -> tuple[Array, Array]:
        """Covariances of the navigation errors at the ends of outages, and the largest attitude error on the way.

        Each sensor has the filter that knows its figures.

        Parameters
        ----------
        sensors : sequence of Sensor
        seconds : sequence of float
            Lengths of the outages, s.
        aids : mapping of name to AidUse, optional
            What goes on measuring in the outages.

        Returns
        -------
        (sensors, lengths, starts, 9, 9) array, (sensors,) array
            The second is a standard deviation, rad.

        Raises
        ------
        InputError
            A track that is too short.
        """
        order = np.argsort(seconds)
        starts = self.starts(max(seconds))
        ends = np.searchsorted(self.t, self.t[starts, None] + np.asarray(seconds)[None, order] - 1e-6).astype(np.int64)
        H, var = self.measurements(aids or {})
        found, attitude = np.empty((len(sensors), len(seconds), starts.size, 9, 9)), np.empty(len(sensors))
        alike: dict[tuple[tuple[float, ...], bool], list[int]] = {}
        for i, one in enumerate(sensors):
            alike.setdefault(one.kind(self.dt), []).append(i)
        for members in alike.values():
            states = states_of([sensors[i] for i in members], self.dt)
            E, D, N, C, R = self.responses(states)
            track = Nodes(self.F, E, D, N, C, R, H, var)
            m = track.E.shape[2]
            for first in range(0, len(members), LANES):
                some = members[first : first + LANES]
                lanes = np.minimum(np.arange(first, first + LANES), len(members) - 1)
                shapes = ((9 + m, 9 + m), (starts.size, len(seconds), 9, 9), (m,), (6,), (1,))
                P, out, q, white, most = (empty((*shape, LANES)) for shape in shapes)
                P[:], most[:] = 0.0, 0.0
                P[range(9), range(9)] = self.start[:, None] ** 2
                P[range(9, 9 + m), range(9, 9 + m)] = states.P0[:, lanes]
                q[:], white[:] = states.q[:, lanes], states.white[:, lanes]
                driven = Driven(lanes_of(q), lanes_of(white), lanes_of(P))
                outages(track, driven, starts, ends, lanes_of(out), lanes_of(most))
                found[np.array(some)[:, None], order] = out.transpose(4, 1, 0, 2, 3)[: len(some)]
                attitude[some] = np.sqrt(most[0, : len(some)])
        return found, attitude


def kept(name: str, parts: Sequence[object], make: Callable[[], dict[str, Array]]) -> dict[str, Array]:
    """Arrays of an earlier call with the same parts, or those made now and kept beside the compiled kernels.

    Parameters
    ----------
    name : str
        What they are.
    parts : sequence
        All that they depend on, besides the program itself.
    make : callable
    """
    key = hashlib.sha256(repr((code_version(), *parts)).encode()).hexdigest()[:24]
    file = own_folder() / "require" / f"{name}-{key}.npz"
    try:
        with np.load(file, allow_pickle=False) as found:
            return {label: found[label] for label in found.files}
    except (OSError, ValueError, BadZipFile):
        arrays = make()
    buffer = io.BytesIO()
    np.savez(buffer, allow_pickle=False, **arrays)
    try:
        put(file, buffer.getvalue())
        for old in sorted(file.parent.glob("*.npz"), key=lambda path: path.stat().st_mtime)[:-MOST_KEPT]:
            old.unlink(missing_ok=True)
    except OSError:
        pass  # where nothing can be kept it is made again
    return arrays


def prepared(scenario: Scenario, file: str | Path | None, inputs: Mapping[str, Path]) -> tuple[Track, str]:
    """The track of a scenario, kept from an earlier call where it is the same, and the digest of what it depends on.

    Parameters
    ----------
    scenario : Scenario
    file : path, optional
        Where it was read from.
    inputs : mapping of str to path
        Files that it names.
    """
    source, gnss = scenario.trajectory, scenario.gnss
    assert source is not None
    contents = [hashlib.sha256(path.read_bytes()).hexdigest() for path in inputs.values()]
    names = {"waypoints": None, "track": None, "motion": None}
    parts = (
        source.model_dump(mode="json") | names,
        gnss.model_dump(mode="json", exclude={"outages"}),
        scenario.initial.model_dump(),
    )
    key = hashlib.sha256(repr((contents, *parts)).encode()).hexdigest()
    clear = scenario.model_copy(update={"gnss": gnss.model_copy(update={"outages": ()})})
    held = kept("track", [key], lambda: {name: np.asarray(v) for name, v in vars(Track.of(clear, file)).items()})
    return Track(**held | {"dt": float(held["dt"])}), key  # type: ignore[arg-type]


def aids_of(text: str) -> dict[str, AidUse | None]:
    """Aids as they are written: ``odometer=0.05 m/s, heading=0.5 deg, standstill``.

    Raises
    ------
    InputError
        An unknown aid, one that has no errors of its own kind, or a sigma of another dimension.
    """
    out: dict[str, AidUse | None] = {}
    known = [name for name, aid in AIDS.items() if aid.truth is not None]
    for part in filter(None, (p.strip() for p in text.split(","))):
        name, _, sigma = (p.strip() for p in part.partition("="))
        if name == "standstill" and not sigma:
            out[name] = None
        elif name in known and sigma:
            out[name] = AidUse.from_mapping(AIDS[name], {"sigma": sigma, "rate": AID_RATE})
        else:
            raise InputError(
                f"found '{part}', expected NAME=SIGMA with {', '.join(known)}, or standstill", where="--aids"
            )
    return out
