"""A prepared recording with the responses of everything that could be missing, at one set of levels, colours and corrections."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from insemu.effects import EFFECTS, Column, FixGeometry, Motion, catalogue_columns
from insemu.errors import InputError
from insemu.gap.drive.changes import Changing
from insemu.gap.drive.columns import filled_columns, rectified_columns
from insemu.gap.drive.corrected import corrected_data, slow_knots
from insemu.gap.drive.fix_outliers import without
from insemu.gap.drive.preparation import Prepared, fitted_levels
from insemu.gap.drive.signatures import Loop, bias_steps, columns_response, fix_step_response, knot_response, ramps
from insemu.gap.drive.sizes import SIZE_REL, has_size, known_size, likeliest_size, slope_about, smoothing
from insemu.gap.evidence.linear import Block, Field
from insemu.gap.evidence.surrogate import FixNoise, Gains, Surrogate
from insemu.gap.policy import rules
from insemu.noise import NoiseModel
from insemu.records import GnssRecord

Array = NDArray[np.float64]

#: A step: place, start and end in s. Places 0 to 2 are components of the position fixes, north, east, down; 3 to 8 biases of the sensors' six axes;
#: from ARMS on axes of the lever arm; from TERMS on errors that follow a signal (:attr:`Scene.changing`).
Window = tuple[int, float, float]
ARMS, TERMS = 9, 12

#: Times that the filter runs again at the most, on corrected data until its errors are small, or at other levels: a bound, so that a search ends.
MOST_RUNS = 5
#: Shares of a correction that are tried, and by what share of its own squares what is left may grow: with half of it wrong it still converges.
#: Judged by ``python -m tests.real_gaps``: where nothing may be left more, smoothed velocities stay at their first guess.
SHARES, BENT = (1.0, 0.3), 0.25
#: Starts of steps in the fixes that are tried first, and of changes of the lever arm.
STARTS, ARM_STARTS = 120, 40
#: What a scene knows that other noise of the fixes leaves as it is, and what more steps in the fixes do.
_RESPONSES = ("_answers", "_ramps", "steps_raw", "_arms_raw", "changing")
_WHITENED = ("_plain", "full_y", "step_columns", "arm_columns", "_gains")


@dataclass
class Scene:
    """A prepared recording with responses.

    Parameters
    ----------
    prepared : Prepared
        The filter as it ran, on corrected data where effects were corrected.
    original : Prepared
        The same before any correction.
    motion, loop, surrogate
        What the filter says about motion, innovations and covariances.
    columns : list of Column
        Catalogue first; behind it stand the filled-in stretches and what the vehicle's shaking rectifies.
    catalogue : int
        Number of columns of the catalogue.
    knots, starts : arrays
        Times in s.
    corrections : mapping of column index to number
        What was taken out of the data before the filter ran.
    windows : tuple of Window
        Steps in the fixes and in biases that were found.
    noise : FixNoise, optional
        Colour and levels of the fixes that the whitening allows for.
    """

    prepared: Prepared
    original: Prepared
    motion: Motion
    loop: Loop
    surrogate: Surrogate
    columns: list[Column]
    catalogue: int
    knots: Array
    starts: Array
    corrections: Mapping[int, float]
    windows: tuple[Window, ...] = ()
    noise: FixNoise | None = None

    @classmethod
    def of(
        cls,
        prepared: Prepared,
        original: Prepared | None = None,
        corrections: Mapping[int, float] | None = None,
        windows: tuple[Window, ...] = (),
        known: Sequence[Column] = (),
    ) -> Scene:
        """Collect every column; responses through the filter in the loop are worked out when they are asked for.

        The catalogue's columns of another scene, ``known``, say what corrections are of.
        """
        motion, loop = prepared.motion, Loop.of(prepared.result)
        t_fix = prepared.result.fixes.t
        fixes = FixGeometry.of(motion, t_fix, prepared.lever_arm, prepared.nominal.mounting)
        if (tau := smoothing(prepared.nominal, known, corrections or {})).any():
            fixes = fixes.smoothed(motion, tau)
        columns = catalogue_columns(motion, fixes)
        catalogue = len(columns)
        more = [u for u in prepared.nominal.effects if u.effect.does("more")]
        for j, c in enumerate(columns):
            # of data less a known size: what one more of it does
            size = known_size(prepared.nominal, c)
            columns[j] = slope_about(c, size, motion, fixes) if size else c
            for use in more:
                if (use.id, use.sensor) == (c.effect, c.sensor):
                    columns[j] = use.effect.more(columns[j], use, motion)
        for j, value in (corrections or {}).items():
            if j < catalogue and has_size(prepared.nominal, columns[j]):
                own = (columns[j].effect, columns[j].label)
                slope = slope_about(columns[j], value, motion, fixes)
                columns[:catalogue] = [slope if (c.effect, c.label) == own else c for c in columns[:catalogue]]
        if prepared.first.any():
            columns = [c if c.fixes is None else replace(c, start=c.fixes[0]) for c in columns]
        columns += filled_columns(motion, prepared.repaired.filled if prepared.repaired else ())
        columns += rectified_columns(prepared.rectified)
        start, end = float(motion.t[0]), float(motion.t[-1])
        knots = slow_knots(start, end)
        step = float(np.median(np.diff(t_fix))) if t_fix.size > 1 else end - start
        starts = np.arange(start, end, max(step, (end - start) / STARTS)) + 1e-3
        return cls(
            prepared,
            original or prepared,
            motion,
            loop,
            prepared.surrogate,
            columns,
            catalogue,
            knots,
            starts,
            dict(corrections or {}),
            windows,
        )

    # -- places of the columns --------------------------------------------------------------------------------------------------------

    def slow(self, axis: int, axes: int = 1) -> NDArray[np.int64]:
        """Columns of the knots of an axis (0..5) and of ``axes - 1`` more."""
        k = self.knots.size
        return len(self.columns) + axis * k + np.arange(axes * k)

    @property
    def width(self) -> int:
        """Number of columns, knots and windows."""
        return len(self.columns) + 6 * self.knots.size + len(self.windows)

    @cached_property
    def always(self) -> tuple[Block, ...]:
        """What is uncertain whatever the effects are: the integrals of filled-in stretches, coning and sculling of what shakes."""
        index = np.arange(self.catalogue, len(self.columns))
        return ((index, np.diag([self.columns[i].scale for i in index])),) if index.size else ()

    # -- responses --------------------------------------------------------------------------------------------------------------------

    @cached_property
    def _answers(self) -> Array:
        """Responses (f, 6, c) of the columns, then of the knots of slow errors, axis by axis."""
        return self._responded(np.arange(len(self.columns) + 6 * self.knots.size))

    @cached_property
    def _ramps(self) -> Array:
        """Errors that constants and ramps on each axis build up from node to node."""
        return ramps(self.loop, self.motion)

    @cached_property
    def steps_raw(self) -> Array:
        """Responses (f, 6, 3 starts) of steps in the position fixes."""
        return fix_step_response(self.loop, np.eye(3, 6)[:, None], self.starts)

    @cached_property
    def arm_starts(self) -> Array:
        """Times of changes of the lever arm that are tried first, s: one that is there from the start has no time."""
        start, end = float(self.motion.t[0]), float(self.motion.t[-1])
        return np.asarray(start + (end - start) / ARM_STARTS * (np.arange(ARM_STARTS - 1) + 1.0))

    @cached_property
    def _arms_raw(self) -> Array:
        """Responses (f, 6, 3 starts) of changes of the lever arm; x, y, z for each start."""
        units = np.stack([self.arm_fixes(axis) for axis in range(3)])
        return fix_step_response(self.loop, units, self.arm_starts)

    def arm_fixes(self, axis: int) -> Array:
        """What a metre of lever arm along an axis (0..2) of the body makes of the fixes, (f, 6)."""
        columns = self.columns[: self.catalogue]
        fixes = next(c.fixes for c in columns if (c.effect, c.label) == ("lever_arm", f"value_{'xyz'[axis]}"))
        assert fixes is not None
        return fixes

    def arm_steps(self, axis: int, starts: Array) -> Array:
        """Whitened responses (r, starts) of unit changes of the lever arm along an axis (0..2) of the body from each start (s) on."""
        return self.whitened(fix_step_response(self.loop, self.arm_fixes(axis)[None], starts))

    @cached_property
    def changing(self) -> Changing:
        """Errors that follow a signal, which may begin at a time."""
        return Changing.of(self.loop, self.motion)

    def window_column(self, window: Window) -> Column:
        """A step that was found of the fixes, of the lever arm or of what follows a signal, as a column."""
        (place, start, end), t = window, self.loop.result.fixes.t
        if place >= TERMS:
            return self.changing.column(place - TERMS, self.motion.t, start, end)
        inside = ((t > start) & (t <= end)).astype(np.float64)
        M = np.zeros((t.size, 6))
        if place < 3:
            M[:, place] = inside
        elif place >= ARMS:
            M = self.arm_fixes(place - ARMS) * inside[:, None]
        return Column("window", "gnss", "", (), 1.0, "m", fixes=M)

    @cached_property
    def _asked(self) -> dict[bytes, Array]:
        """What was asked for last of :meth:`_responses`, as it is asked for in turns with other noise of the fixes."""
        return {}

    def _responses(self, index: NDArray[np.int64]) -> Array:
        """Responses (f, 6, k) of some columns, knots and windows."""
        key, asked = index.tobytes(), self._asked
        if key not in asked:
            answer = self._responded(index)
            asked.clear()
            asked[key] = answer
        return asked[key]

    def window_answers(self, windows: Sequence[Window]) -> Array:
        """Responses (f, 6, windows) of unit steps between two times."""
        fixes = self.loop.result.fixes
        M, D = np.zeros((len(fixes), 6, len(windows))), None
        for i, (place, start, end) in enumerate(windows):
            if place < 3 or ARMS <= place < TERMS:
                M[:, :, i] = self.window_column(windows[i]).fixes
                continue
            D = np.zeros((len(self._ramps), len(windows), 9)) if D is None else D
            begun, over = (bias_steps(self.loop, self.motion, np.array([at])) for at in (start, end))
            unit = self._ramps[:, place - 3] if place < ARMS else self.changing.built[:, place - TERMS]
            D[:, i] = (begun - over) * unit
        return self.loop.respond(len(windows), D, M) if windows else M

    def bias_step_columns(self, axis: int, starts: Array) -> Array:
        """Whitened responses (r, starts) of unit steps of the bias of an axis (0..5) from each start (s) on."""
        D = bias_steps(self.loop, self.motion, starts)[:, :, None] * self._ramps[:, axis, None]
        return self.whitened(self.loop.respond(starts.size, D, None))

    def _responded(self, index: NDArray[np.int64]) -> Array:
        c, k = len(self.columns), self.knots.size
        own, late = np.unique(index[index < c]), np.unique(index[index >= c + 6 * k])
        parts, places = [columns_response(self.loop, self.motion, [self.columns[i] for i in own])], [own]
        for axis in np.unique((index[(index >= c) & (index < c + 6 * k)] - c) // k):
            parts.append(knot_response(self.loop, self.motion, self._ramps, self.knots, int(axis)))
            places.append(c + axis * k + np.arange(k))
        parts.append(self.window_answers([self.windows[i - c - 6 * k] for i in late]))
        every = np.concatenate([*places, late])
        together = np.concatenate(parts, axis=2)
        return together if np.array_equal(every, index) else together[:, :, np.searchsorted(every, index)]

    # -- whitened data ----------------------------------------------------------------------------------------------------------------

    @cached_property
    def rows_t(self) -> Array:
        """Time of every row of the field."""
        return np.asarray(np.repeat(self.prepared.result.fixes.t, 6)[self._rows])

    @cached_property
    def _rows(self) -> NDArray[np.int64]:
        """Which of all components, fix by fix, are rows of the field."""
        return np.flatnonzero(self.loop.use)

    def upto(self, cut: float | None) -> slice:
        """Rows of the field up to a time, s; all of them without one."""
        return slice(None if cut is None else int(np.searchsorted(self.rows_t, cut, side="right")))

    @cached_property
    def full_y(self) -> Array:
        """Whitened innovations (f, 6), zero where missing, as if nothing had been corrected."""
        if self.noise is None:
            return self.loop.y.reshape(-1, 6).copy()
        return self.surrogate.whitened(self.surrogate.nu[:, :, None], self._gains)[:, :, 0]

    @cached_property
    def _gains(self) -> Gains:
        """Of the filter that whitens under the noise of the fixes that is allowed for."""
        assert self.noise is not None
        return self.surrogate.gains(self.noise)

    def whitened(self, raw: Array) -> Array:
        """Responses (f, 6, c) to rows of the field (r, c)."""
        if self.noise is None:
            white = self.loop.whiten(raw)
        else:
            white = self.surrogate.whitened(raw, self._gains).reshape(6 * raw.shape[0], raw.shape[2])
        return np.asarray(white.take(self._rows, axis=0))

    @property
    def data(self) -> Field:
        """The field of the whole recording; what was corrected is put back as its linear response about the corrected trajectory."""
        return self.field(None)

    @cached_property
    def _plain(self) -> dict[float | None, Field]:
        """Fields without the windows, whole and up to times that were asked for: no window is corrected in the data."""
        G = self.whitened(self._answers)
        return {None: self._field(G, G[:, list(self.corrections)])}

    @cached_property
    def _wide(self) -> dict[float | None, Field]:
        """The same with the windows."""
        return {}

    def field(self, cut: float | None) -> Field:
        """The field up to a time, s; of the whole recording without one."""
        plain, wide = self._plain, self._wide
        if cut is not None and cut not in plain:
            plain[cut] = plain[None].rows(self.upto(cut))
        if cut not in wide:
            more = self.whitened(self.window_answers(self.windows))[self.upto(cut)]
            wide[cut] = plain[cut].wider(more) if self.windows else plain[cut]
        return wide[cut]

    def _field(self, G: Array, corrected: Array) -> Field:
        """The field of some columns, what was corrected put back."""
        y = self.full_y.ravel()[self._rows]
        spread = float(np.clip((np.median(np.abs(y)) / 0.6745) ** 2, 0.9, 1.1))
        y += corrected @ np.array(list(self.corrections.values()))
        return Field(y, G, spread)

    @cached_property
    def step_columns(self) -> Array:
        """Whitened responses of steps in the fixes, (r, 3 starts)."""
        return self.whitened(self.steps_raw)

    @cached_property
    def arm_columns(self) -> Array:
        """Whitened responses of changes of the lever arm, (r, 3 starts)."""
        return self.whitened(self._arms_raw)

    # -- other scenes of the same recording -------------------------------------------------------------------------------------------

    def with_windows(self, windows: tuple[Window, ...]) -> Scene:
        """The scene with a column for each of these steps, behind all the others."""
        return self if windows == self.windows else self._same(*_RESPONSES, *_WHITENED, windows=windows)

    def coloured(self, noise: FixNoise | None) -> Scene:
        """The same responses whitened for other noise of the fixes, or for that which the filter believed."""
        return self._same(*_RESPONSES, "_asked", noise=noise)

    def _same(self, *known: str, **changes: Any) -> Scene:
        """The scene with other windows or noise of the fixes; of what is known that which does not change."""
        scene = replace(self, **changes)
        scene.__dict__.update({k: v for k, v in self.__dict__.items() if k in known})
        return scene

    def rebuilt(
        self,
        *,
        factors: Array | None = None,
        levels: Array | None = None,
        gone: Mapping[str, Array] | None = None,
        whole: GnssRecord | None = None,
        corrections: Mapping[int, float] | None = None,
        beliefs: dict[str, NoiseModel] | None = None,
    ) -> Scene:
        """Run the filter again: other levels of the fixes, outliers left out, effects corrected in the data, other noise of the IMU.

        Parameters
        ----------
        factors, levels : (6,) arrays, optional
            As those of :class:`insemu.gap.drive.preparation.Prepared`.
        gone : mapping of effect to (k,) array, optional
            Times of the positions or velocities that are left out as outliers, s.
        whole : GnssRecord, optional
            The fixes with all positions, which takes back what was left out before.
        corrections : mapping of int to float, optional
            Column and its coefficient, taken out of the data; those of this scene where they are not given.
        beliefs : mapping of axis to NoiseModel, optional
            Other noise of the IMU.
        """
        original = self.original if whole is None else replace(self.original, gnss=whole)
        if gone:
            original = replace(original, gnss=without(original.gnss, gone))
        if factors is not None:
            original = replace(original, factors=factors)
        if levels is not None:
            original = replace(original, levels=levels)
        if beliefs is not None:
            original = replace(original, beliefs=beliefs)
        values = dict(self.corrections if corrections is None else corrections)
        columns = list(self.columns)
        for j in values:
            if j < self.catalogue and has_size(self.prepared.nominal, columns[j]):
                columns[j] = self._at_size(j, values[j], self._geometry)
        imu, gnss, state = corrected_data(original, columns, values, self.prepared.result.fixes.t)
        run = replace(original, result=self.prepared.result, start=(state, original.start[1]))
        known, run = self.columns[: self.catalogue], run.again(imu=imu, gnss=gnss)
        return Scene.of(run, original, values, self.windows, known).coloured(self.noise)

    def corrected_again(self, blocks: Sequence[Block], cut: float | None = None) -> Scene:
        """The scene with velocities as the shaking leaves them next to what was found: on a lever arm that was, and without what stood for noise.

        Parameters
        ----------
        blocks : sequence of Block
            What is explained.
        cut : float, optional
            Fixes after this time (s) are not looked at.
        """
        original, arm = self.original, self.original.lever_arm.copy()
        index, away = self.explaining(blocks, cut)
        for j, value in zip(index, away, strict=True):
            if j < self.catalogue and self.columns[j].effect == "lever_arm":
                arm["xyz".index(self.columns[j].label[-1])] += value + self.corrections.get(int(j), 0.0)
        if np.array_equal(arm, original.lever_arm) and not np.any(original.raised > 1.0):
            return self
        return replace(self, original=original.on_arm(self.prepared, arm)).rebuilt()

    def trimmed(self, blocks: Sequence[Block], cut: float | None = None) -> Scene:
        """The scene with the levels of the fixes at their most likely values inside the tolerance, given what is explained."""
        scene = self
        for _ in range(MOST_RUNS if self.noise is None else 0):
            at, s = scene.original, replace(scene.surrogate, nu=scene.unexplained(blocks, cut))
            moved = fitted_levels(at, scene.loop.white, s if cut is None else s.until(cut), back=True)
            if moved is at:
                break
            # what is explained is another beside other levels
            scene = scene.rebuilt(factors=moved.factors, levels=moved.levels)
        return scene

    def linear_about(self, blocks: Sequence[Block], strong: Collection[int], cut: float | None = None) -> Scene:
        """The filter run again on data without some columns at their best values, until what is left of these is linear.

        Parameters
        ----------
        blocks : sequence of Block
            What is explained.
        strong : collection of int
            Columns and knots that are taken out of the data.
        cut : float, optional
            Fixes after this time (s) are not looked at.
        """
        scene = self
        if back := self._unnamed(blocks):
            scene = self.rebuilt(corrections={j: v for j, v in self.corrections.items() if j not in back})
        for _ in range(MOST_RUNS if strong else 0):
            index, away = scene.explaining(blocks, cut)
            own = np.isin(index, list(strong))
            beyond = scene._columns(index[own]) @ away[own]
            if not 0.5 * float(beyond @ beyond) > rules().correct_nats:
                break
            nearer = scene._nearer(dict(zip(index[own].tolist(), away[own].tolist(), strict=True)), blocks, cut)
            if nearer is None:  # what is left stays linear
                break
            scene = nearer
        return scene

    def _unnamed(self, blocks: Sequence[Block]) -> set[int]:
        """Columns that were taken out of the data for findings that are none any more."""
        return set(self.corrections) - {int(i) for index, _ in blocks for i in index}

    def _nearer(self, away: Mapping[int, float], blocks: Sequence[Block], cut: float | None) -> Scene | None:
        """The scene with columns corrected by these further numbers, or by a part of them; ``None`` where that leads away from what they answer.

        Next to other errors a linear answer can be wrong by more than itself, and each further one by more than the one before.
        """
        left, answer = self._left(blocks, cut), self._columns(np.array(list(away))) @ np.array(list(away.values()))
        for share in SHARES:
            values = {j: self.corrections.get(j, 0.0) + share * away.get(j, 0.0) for j in {**self.corrections, **away}}
            try:
                scene = self.rebuilt(corrections={j: v for j, v in values.items() if v != 0.0})
            except InputError:  # corrected so far that no filter runs on it
                continue
            if scene._left(blocks, cut) < left + max(rules().lead, 0.5 * BENT * share**2 * float(answer @ answer)):
                return scene
        return None

    def _left(self, blocks: Sequence[Block], cut: float | None) -> float:
        """Half the sum of squares of what blocks leave of the field up to a time."""
        index, away = self.explaining(blocks, cut)
        z = (self.full_y.ravel()[self._rows] - self._columns(index) @ away)[self.upto(cut)]
        return 0.5 * float(z @ z)

    def at_size(self, blocks: Sequence[Block], cut: float | None = None) -> Scene:
        """The filter run again without the effects that are no multiple of one column, each taken off at its most likely size.

        Parameters
        ----------
        blocks : sequence of Block
            What is explained.
        cut : float, optional
            Fixes after this time (s) are not looked at.
        """
        named = {int(i) for index, _ in blocks for i in index if i < self.catalogue}
        nominal = self.prepared.nominal
        sizes = {j: self._likeliest(j, blocks, cut) for j in named if has_size(nominal, self.columns[j])}
        if all(math.isclose(v, self.corrections.get(j, 0.0), rel_tol=SIZE_REL) for j, v in sizes.items()):
            return self
        further = {j: -self.corrections[j] for j in self._unnamed(blocks)}
        further |= {j: v - self.corrections.get(j, 0.0) for j, v in sizes.items()}
        return self._nearer(further, blocks, cut) or self

    def _likeliest(self, j: int, blocks: Sequence[Block], cut: float | None) -> float:
        """The size of an effect at which its own shape leaves least of the innovations, next to everything else in blocks."""
        column = self.columns[j]
        # other columns of the effect are it at another size
        same = {
            i
            for i in self.corrections
            if i < self.catalogue and (self.columns[i].effect, self.columns[i].label) == (column.effect, column.label)
        }
        taken, others = sum(self.corrections[i] for i in same), [i for i in self.corrections if i not in same]
        rest = [(i[i != j], root[i != j]) for i, root in blocks]
        index = np.unique(np.concatenate([np.array(others, dtype=np.int64), *(i for i, _ in rest)]))
        G = self.whitened(self._responses(index))
        put_back = G[:, np.searchsorted(index, others)] @ np.array([self.corrections[i] for i in others])
        y, rows = self.full_y.ravel()[self._rows] + put_back, self.upto(cut)
        # what the rest explains of anything, as a projection
        W = np.hstack([np.zeros((y.size, 0)), *(G[:, np.searchsorted(index, i)] @ root for i, root in rest)])[rows]
        rest_of = np.linalg.solve(np.linalg.cholesky(np.eye(W.shape[1]) + W.T @ W), W.T)

        fixes, nodes = self._geometry, len(self.motion.node)

        def left(size: float) -> float:
            shape = self._at_size(j, size, fixes)
            assert shape.fixes is not None
            begun = np.zeros((nodes, 1, 9))
            begun[0, 0, :6] = 0.0 if shape.start is None else shape.start
            answer = self.whitened(self.loop.respond(1, begun, shape.fixes[:, :, None]))[:, 0]
            z = (y - (size - taken) * answer)[rows]
            explained = rest_of @ z
            return float(z @ z - explained @ explained)

        return likeliest_size(left, column)

    @property
    def _geometry(self) -> FixGeometry:
        """The fixes along the motion."""
        prepared = self.prepared
        return FixGeometry.of(self.motion, prepared.result.fixes.t, prepared.lever_arm, prepared.nominal.mounting)

    def _at_size(self, j: int, size: float, fixes: FixGeometry) -> Column:
        """A column of an effect that is no multiple of one, at a size."""
        column = EFFECTS[self.columns[j].effect].about(self.columns[j], size, self.motion, fixes)
        assert column.fixes is not None
        return replace(column, start=column.fixes[0]) if self.prepared.first.any() else column

    def _columns(self, index: NDArray[np.int64]) -> Array:
        """Some columns of the field, (r, k)."""
        return self.data.G[:, index] if "_plain" in self.__dict__ else self.whitened(self._responses(index))

    def log_likelihood(self, blocks: Sequence[Block], cut: float | None = None) -> float:
        """Of the innovations up to a time, what blocks explain of those after corrections taken for as likely as its prior says.

        Only of scenes without other noise of the fixes than their filter believes.
        """
        use = self.loop.use & (self.loop.result.fixes.t <= (math.inf if cut is None else cut))[:, None]
        rows = use[self.loop.use]
        y = self.full_y.ravel()[use.ravel()]
        plain = -0.5 * float(y @ y) - self.loop.half_log_det(use)
        if not blocks:
            return plain
        index = np.unique(np.concatenate([i for i, _ in blocks]))
        own = [(np.searchsorted(index, i), root) for i, root in blocks]
        return plain + Field(y, self._columns(index)[rows]).log_factor(own)

    def unexplained(self, blocks: Sequence[Block], cut: float | None = None) -> Array:
        """Innovations (f, 6) in m and m/s less what blocks explain of them, judged by those up to a time; zero where missing."""
        return self.residual_innovations(*self.explaining(blocks, cut))

    def residual_innovations(self, index: NDArray[np.int64], coefficients: Array) -> Array:
        """Innovations (f, 6) in m and m/s less some columns (k,) times their coefficients (k,); zero where missing."""
        explained: Array | float = 0.0
        if index.size and "_answers" in self.__dict__:
            each = np.zeros(self.width)
            each[index] = coefficients
            plain = self._answers.shape[2]
            explained = self._answers @ each[:plain] + self.window_answers(self.windows) @ each[plain:]
        elif index.size:
            explained = self._responses(index) @ coefficients
        return np.where(self.surrogate.use == 1, self.surrogate.nu - explained, 0.0)

    def explaining(self, blocks: Sequence[Block], cut: float | None) -> tuple[NDArray[np.int64], Array]:
        """Columns that explain innovations after corrections, and their coefficients: those of the blocks less what was corrected."""
        corrected = np.array(list(self.corrections), dtype=np.int64)
        index = np.unique(np.concatenate([corrected, *(i for i, _ in blocks)]))
        coefficients = np.zeros(index.size)
        if blocks and "_plain" in self.__dict__:
            at, mean, _ = self.field(cut).posterior(blocks)
            np.add.at(coefficients, np.searchsorted(index, at), mean)
        elif blocks:  # of a scene that may be rebuilt at once only what is asked for
            G = self.whitened(self._responses(index))
            data = self._field(G, G[:, np.searchsorted(index, corrected)]).rows(self.upto(cut))
            at, mean, _ = data.posterior([(np.searchsorted(index, i), root) for i, root in blocks])
            np.add.at(coefficients, at, mean)
        coefficients[np.searchsorted(index, corrected)] -= np.array(list(self.corrections.values()))
        return index, coefficients
