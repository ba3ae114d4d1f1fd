"""What aids are off by: an odometer, a barometer, a heading held against the smoothed run of IMU and fixes, which does not use them."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from insemu.effects import AID_KINDS, EFFECTS, EffectUse, Stage, aid_corrected
from insemu.filters import AIDS
from insemu.gap.candidates.aid_outliers import FarOff, far_off
from insemu.gap.checks.aids import check_unit, stands
from insemu.gap.drive.aid_residuals import Measured, Shown, Smoothed
from insemu.gap.drive.preparation import Prepared
from insemu.gap.evidence.aid_model import AidModel
from insemu.gap.hypothesis import class_of, probabilities
from insemu.gap.policy import rules
from insemu.gap.verdict import Finding, Interval, Member, Value, Where
from insemu.gap.worth import worth_of_aids
from insemu.records import AidRecord

Array = NDArray[np.float64]

#: Effects that one aid can have at the most.
MOST_STEPS = 8
#: How often an aid is put right by sizes that moved, and by how much they may still be off, in standard deviations.
MOST_TAKEN, LEAST_TAKEN = 5, 0.02
#: Blocks of the last part of an aid below which nothing is judged on it.
FEWEST_BLOCKS = 10
#: Shapes that are weighed at their own noise, the best at the noise of the model before.
MOST_FITTED = 4


@dataclass(frozen=True)
class AidReport:
    """What was found of the aids of a recording, how each stands against the run before and after, and the gain on its last part, nats per block."""

    findings: tuple[Finding, ...] = ()
    where: tuple[Where, ...] = ()
    after: tuple[Where, ...] = ()
    held_out: Mapping[str, Interval] = field(default_factory=dict)


@dataclass(frozen=True)
class _Candidate:
    """Something that an aid may have, weighed."""

    effect: str
    columns: tuple[int, ...]
    rows: tuple[int, ...]
    nats: float
    model: AidModel


@dataclass(frozen=True)
class _Step:
    """What was named, and what it was compared with."""

    chosen: _Candidate
    members: tuple[Member, ...]
    others: tuple[Member, ...]
    confidence: float

    def worth(self, nats: float) -> _Step:
        """The same, worth something else next to everything that was named later; what it was compared with stays as it was then."""
        return replace(self, chosen=replace(self.chosen, nats=nats))


@dataclass
class _State:
    """One aid on its way: what it is off by less what was named, and the model of that."""

    smoothed: Smoothed
    shown: Shown
    known: AidRecord
    measured: Measured
    model: AidModel
    taken: dict[tuple[str, str], float] = field(default_factory=dict)
    gone: FarOff | None = None
    struck: Array = field(default_factory=lambda: np.zeros(0))
    steps: list[_Step] = field(default_factory=list)

    @property
    def labels(self) -> tuple[tuple[str, str], ...]:
        return self.model.data.labels

    def at(self, taken: Mapping[tuple[str, str], float]) -> _State | None:
        """The same with other sizes of effects taken off beforehand; None where too little of the aid is left."""
        uses: dict[str, dict[str, tuple[float, ...]]] = {}
        for (effect, label), value in taken.items():
            uses.setdefault(effect, {})[label] = (value,)
        known = [EffectUse(effect, self.known.kind, values) for effect, values in uses.items()]
        measured = Measured.of(aid_corrected(self.known, known, float(self.known.t[0])), self.shown)
        if measured is None:
            return None
        model = replace(self.model, data=measured.blocks(self.smoothed))
        return replace(self, measured=measured, model=model.fitted(), taken=dict(taken))

    def size(self, column: int) -> tuple[float, float]:
        """Size of a named unit effect and its standard deviation, what was taken off counted, SI."""
        mean, covariance = self.model.estimates()
        k = self.model.columns.index(column)
        name = self.labels[column]
        size, most = float(mean[k]) + self.taken.get(name, 0.0), _most(*name)
        return min(max(size, -most), most), math.sqrt(covariance[k, k])


def is_judged(kind: str) -> bool:
    """Whether an aid of this kind is held against the fixes: it can be predicted, and there are effects that it may have."""
    return kind in AIDS and AIDS[kind].truth is not None and kind in AID_KINDS


def check_aids(prepared: Prepared, aids: Sequence[AidRecord], source: str) -> None:
    """Look whether aids are what their names say, before a search that takes long.

    Parameters
    ----------
    prepared : Prepared
        A filter on the recording less what is settled before the search, which uses no aid.
    aids : sequence of AidRecord
        Less what is known of them.
    source : str
        Where they came from, for messages.

    Raises
    ------
    InputError
        An aid that is another quantity or in another unit than its name says.
    """
    smoothed = Smoothed.of(prepared) if aids else None
    for aid in aids:
        assert smoothed is not None
        _, measured = _compared(smoothed, aid)
        if measured is not None:
            check_unit(measured, source)


def _compared(smoothed: Smoothed, aid: AidRecord) -> tuple[Shown | None, Measured | None]:
    """What a smoothed run shows an aid, and the aid against it; None where it says nothing."""
    shown = smoothed.shown_to(aid) if is_judged(aid.kind) else None
    return shown, None if shown is None else Measured.of(aid, shown)


def find_aid_effects(
    prepared: Prepared,
    aids: Sequence[AidRecord],
    without: Collection[str],
    say: Callable[[str], None],
    *,
    hold_out: bool = False,
) -> AidReport:
    """Find and name what aids are off by.

    Parameters
    ----------
    prepared : Prepared
        The refined filter on the recording, which uses no aid.
    aids : sequence of AidRecord
        Less what is known of them.
    without : collection of str
        Effects taken out of the catalogue.
    say : callable
        Told what is being done.
    hold_out : bool
        Whether what was found is judged on the last part of each aid, by what its first part names.
    """
    smoothed, known = Smoothed.of(prepared) if aids else None, prepared.nominal.effects
    findings: list[Finding] = []
    where: list[Where] = []
    after: list[Where] = []
    struck: dict[str, Array] = {}
    held: dict[str, Interval] = {}
    for aid in aids:
        assert smoothed is not None
        shown, measured = _compared(smoothed, aid)
        if shown is None or measured is None:
            continue
        say(f"the {aid.kind} against IMU and fixes")
        state = _State(smoothed, shown, aid, measured, nominal_model(measured, smoothed, known))
        start = _outliers_out(state, without, known)
        where += stands(start.model)
        found = _searched(start, without)
        if found.taken and _only_late(state, found):
            start, found = state, _searched(state, without)
        state = found
        after += stands(state.model)
        if hold_out and state.steps:
            say(f"the last part of the {aid.kind}")
            gain = _held_out(start, without, known)
            held |= {} if gain is None else {aid.kind: gain}
        findings += _reported(state)
        struck[aid.kind] = state.struck
    findings = worth_of_aids(prepared, aids, findings, struck)
    return AidReport(tuple(sorted(findings, key=lambda s: -s.nats)), tuple(where), tuple(after), held)


def _held_out(whole: _State, without: Collection[str], known: Sequence[EffectUse]) -> Interval | None:
    """Gain of the log score per block on the last part of an aid by what its first part names, with the numbers of that part; None of a short one.

    Outliers were found on all of it and are left out of both.
    """
    t = whole.known.t
    cut = float(t[0] + rules().naming_share * (t[-1] - t[0]))
    part = replace(whole, known=whole.known.rows(t <= cut))
    measured = Measured.of(part.known, whole.shown)
    if measured is None:
        return None
    nominal = nominal_model(measured, whole.smoothed, known)
    named = _searched(replace(part, measured=measured, model=nominal), without)
    plain, found = replace(nominal, data=whole.model.data), replace(whole, model=named.model).at(named.taken)
    if found is None:
        return None
    # .at() fits the noise anew, which would look at the last part
    found_model = replace(found.model, noise=named.model.noise)
    sizes = named.model.estimates()[0]
    before, after = plain.scores(np.zeros(0)), found_model.scores(sizes)
    n = min(np.count_nonzero(m.data.t > cut) for m in (plain, found_model))
    if n < FEWEST_BLOCKS:
        return None
    gain = after[-n:] - before[-n:]
    return Interval.normal(float(gain.mean()), float(gain.std()) / math.sqrt(n))


def nominal_model(measured: Measured, smoothed: Smoothed, known: Sequence[EffectUse] = ()) -> AidModel:
    """What is stated and known of an aid, with unit effects at the scale of their datasheets.

    Parameters
    ----------
    measured : Measured
    smoothed : Smoothed
    known : sequence of EffectUse
        Of which the errors that last are in the model.
    """
    data = measured.blocks(smoothed)
    scales = np.array([EFFECTS[e].scale(label, data.kind) for e, label in data.labels])
    lasting: dict[int, tuple[float, float]] = {}
    for use in known:
        if use.sensor == data.kind and "widened" in use.effect.traits:
            rows = [use.effect.axes.index(row) if use.effect.axes else 0 for row in data.rows]
            sizes = [use["sigma"][row] for row in rows]
            lasting |= {k: (s / float(data.std[k]), use.scalar("tau")) for k, s in enumerate(sizes) if s > 0.0}
    return AidModel.nominal(data, scales, lasting)


# -- outliers -------------------------------------------------------------------------------------------------------------------------------


def _outliers_out(state: _State, without: Collection[str], known: Sequence[EffectUse]) -> _State:
    """The aid without measurements that are more likely far off than not, where a share of them is."""
    found = None if "aid_outliers" in without else far_off(state.measured)
    if found is None:
        return state
    kept = state.measured.rows_kept(~found.gone)
    struck = state.measured.aid.t[found.gone]
    # where it is known that there are some, they are no finding
    gone = None if any((u.id, u.sensor) == ("aid_outliers", state.known.kind) for u in known) else found
    model = nominal_model(kept, state.smoothed, known)
    return replace(state, known=state.known.without(struck), measured=kept, model=model, gone=gone, struck=struck)


def _only_late(whole: _State, found: _State) -> bool:
    """Whether nothing of the whole aid is far off next to what turns or shifts it, and something was: what comes late is far off in manoeuvres."""
    beside = whole.at(found.taken) if found.struck.size else None
    return beside is not None and far_off(beside.measured) is None


# -- search ---------------------------------------------------------------------------------------------------------------------------------


def _searched(state: _State, without: Collection[str]) -> _State:
    """The aid with everything that is worth naming, the best first; a change of the lag takes what should have been measured anew."""
    for _ in range(MOST_STEPS):
        tried = sorted(_candidates(state.model, without), key=lambda c: -c.nats)
        if not tried or tried[0].nats < rules().least_nats:
            break
        if probabilities([c.nats for c in tried])[-1] > 1.0 - rules().something:
            break
        model = state.model
        rivals = [Member(c.effect, model.data.kind, _axes(model, c), c.nats) for c in _one_each(tried)]
        members, others, confidence = class_of(rivals, 0)
        state = replace(state, model=tried[0].model, steps=[*state.steps, _Step(tried[0], members, others, confidence)])
        state = _at_size(state)
    return _kept(state)


def _kept(state: _State) -> _State:
    """The aid with what is worth something next to everything else that was named, each at that worth; the least goes first."""
    while len(state.steps) > 1 or state.taken:
        worth = [_without(state, s.chosen) for s in state.steps]
        least = int(np.argmin([nats for nats, _ in worth]))
        if worth[least][0] >= rules().keep_nats:
            return replace(state, steps=[s.worth(nats) for s, (nats, _) in zip(state.steps, worth, strict=True)])
        state = replace(worth[least][1], steps=[s for k, s in enumerate(state.steps) if k != least])
    return state


def _without(state: _State, c: _Candidate) -> tuple[float, _State]:
    """What something that was named is worth next to the rest, and the aid without it."""
    model, noise = state.model, state.model.noise
    if c.columns:
        less = replace(model, columns=tuple(k for k in model.columns if k not in c.columns)).fitted()
        if any(name[0] == c.effect for name in state.taken):  # it was taken off already
            back = replace(state, model=less).at({name: v for name, v in state.taken.items() if name[0] != c.effect})
            if back is not None:
                return model.of_means() - back.model.of_means(), back
        gain = less.gain_of_columns(c.columns)
        return _shape_weighed(less, gain, c.effect, c.columns).nats, replace(state, model=less)
    row, new = c.rows[0], tuple[int, ...]()
    if c.effect.endswith("noise_level"):
        noise, new = replace(noise, named=tuple(r for r in noise.named if r != row)), (row,)
    else:
        noise, new = (
            replace(noise, lasting={r: v for r, v in noise.lasting.items() if r != row}),
            model.place_of_lasting(row),
        )
    less = replace(model, noise=noise).fitted()
    return less.gain_of_noise(model, new), replace(state, model=less)


def _one_each(tried: Sequence[_Candidate]) -> list[_Candidate]:
    """The best candidate of each effect on the same rows: nested ones are no rivals."""
    out: list[_Candidate] = []
    for c in tried:
        if not any(c.effect == o.effect and (c.columns or o.columns or c.rows == o.rows) for o in out):
            out.append(c)
    return out


def _at_size(state: _State) -> _State:
    """The aid less what turns or shifts it, at its size: twice as much is not twice the error of a small one."""
    for _ in range(MOST_TAKEN):
        bent = [k for k in state.model.columns if EFFECTS[state.labels[k][0]].stage in (Stage.MOUNTING, Stage.STAMP)]
        sizes = {state.labels[k]: state.size(k) for k in bent}
        if all(abs(v - state.taken.get(name, 0.0)) <= LEAST_TAKEN * sd for name, (v, sd) in sizes.items()):
            break
        moved = state.at({name: v for name, (v, _) in sizes.items()})
        if moved is None:
            break
        state = moved
    return state


def _candidates(model: AidModel, without: Collection[str]) -> list[_Candidate]:
    """Everything that could be added to a model."""
    d = model.data
    shapes: list[tuple[float, str, tuple[int, ...]]] = []
    for effect in EFFECTS.values():
        if d.kind not in effect.sensors or effect.id in without:
            continue
        own = [k for k, (e, _) in enumerate(d.labels) if e == effect.id and k not in model.columns]
        sets = [(k,) for k in own] + ([tuple(own)] if len(own) > 1 else []) + ([tuple(own[:2])] if len(own) > 2 else [])
        for new in sets:
            if not any(np.any(d.columns[k]) for k in new) or not _plausible(model, new):
                continue
            shapes.append((model.gain_of_columns(new), effect.id, new))
    shapes.sort(key=lambda s: -s[0])
    out = [_shape_weighed(model, gain, effect, new, k < MOST_FITTED) for k, (gain, effect, new) in enumerate(shapes)]
    level, lasting = f"{d.kind}_noise_level", f"{d.kind}_correlated_noise"
    for row in range(len(d.rows)):
        if level in EFFECTS and level not in without and model.at_edge(row):
            out += _noisier(model, model.with_level(row), level, row, [row])
        if lasting in EFFECTS and lasting not in without and row not in model.noise.lasting:
            more = model.with_lasting(row)
            if more is None:
                continue
            out += _noisier(model, more, lasting, row, more.place_of_lasting(row))
    return out


def _plausible(model: AidModel, new: tuple[int, ...]) -> bool:
    """Whether unit effects, some more among them, would have sizes that they can have: what a drive hardly shows may fit anything."""
    columns = (*model.columns, *new)
    sizes, _ = replace(model, columns=columns).estimates()
    return bool(np.all(np.abs(sizes) <= [_most(*model.data.labels[k]) for k in columns]))


def _most(effect: str, label: str) -> float:
    """Largest plausible size of a unit effect."""
    return EFFECTS[effect].parameter(label).most or math.inf


def _shape_weighed(
    model: AidModel, gain: float, effect: str, new: tuple[int, ...], fitted_too: bool = True
) -> _Candidate:
    """Unit effects, weighed at the noise of a model already, at their own noise: what they explain is none."""
    more = replace(model, columns=(*model.columns, *new))
    if fitted_too and (gain > 0.0 or model.noise.lasting):  # an error that lasts may stand for a constant
        fitted = more.fitted().restarted()
        gain, more = gain + max(fitted.likelihood() - more.likelihood(), 0.0), fitted
    return _Candidate(effect, new, (), gain, more)


def _noisier(model: AidModel, more: AidModel, effect: str, row: int, new: Sequence[int]) -> list[_Candidate]:
    if more.likelihood() - model.likelihood() < rules().least_nats:
        return []
    return [_Candidate(effect, (), (row,), model.gain_of_noise(more, new), more)]


def _axes(model: AidModel, c: _Candidate) -> tuple[str, ...]:
    return tuple(model.data.rows[row] for row in c.rows) if EFFECTS[c.effect].axes else ()


# -- answers --------------------------------------------------------------------------------------------------------------------------------


def _reported(state: _State) -> list[Finding]:
    """Findings of an aid with the numbers of everything together."""
    model, d = state.model, state.model.data
    spread = model.spread(inside=True) if any(s.chosen.rows for s in state.steps) else np.zeros((0, 0))
    out: list[Finding] = []
    for step in state.steps:
        c, effect = step.chosen, EFFECTS[step.chosen.effect]
        values: list[Value] = []
        for k in c.columns:
            label = d.labels[k][1]
            values.append(Value.normal(label, *state.size(k), effect.unit(label, d.kind)))
        for name, number in d.settled.get(c.effect, {}).items() if c.columns else ():
            values.append(Value(name, number, number, number, effect.unit(name, d.kind)))
        for row in c.rows:
            values += _noise_values(model, c, row, spread)
        finding = Finding(
            c.effect, "", d.kind, _axes(model, c), tuple(values), step.confidence, c.nats, step.members,
            _would_separate(step.members), step.others,
        )  # fmt: skip
        out = _with(out, finding)
    if state.gone is not None:
        mixture, std = state.gone.mixture, state.gone.std
        nats, unit = mixture.nats, EFFECTS["aid_outliers"].unit("sigma", d.kind)
        values = [
            Value.positive("probability", mixture.share, mixture.spread[0], ""),
            Value.positive("sigma", mixture.size * std, mixture.spread[1], unit),
        ]
        member = Member("aid_outliers", d.kind, (), nats)
        out.append(Finding("aid_outliers", "", d.kind, (), tuple(values), 1.0 - math.exp(-nats), nats, (member,)))
    return out


def _noise_values(model: AidModel, c: _Candidate, row: int, spread: Array) -> list[Value]:
    """Level of a row, or size and time of what lasts on it."""
    d, effect = model.data, EFFECTS[c.effect]
    tail = f"_{d.rows[row]}" if effect.axes else ""
    place, _ = model.place()

    def value(name: str, at: int, unit: str, scale: float) -> Value:
        low, high = model.interval(at, spread)
        middle, low, high = (scale * math.exp(v) for v in (float(place[at]), low, high))
        return Value(name, middle, low, high, unit)

    if "factor" in {p.name for p in effect.parameters}:
        factor = value(f"factor{tail}", row, "", 1.0)
        # some of it may be what the vehicle shakes
        return [replace(factor, low=math.sqrt(max(factor.low**2 - float(d.shaken[row]), 0.0)))]
    of_sigma, of_tau = model.place_of_lasting(row)
    sigma = value(f"sigma{tail}", of_sigma, effect.unit("sigma", d.kind), float(d.std[row]))
    return [sigma, value("tau", of_tau, "s", 1.0)]


def _with(findings: list[Finding], new: Finding) -> list[Finding]:
    """The findings with a new one; further numbers of one effect join the first find of it."""
    for k, s in enumerate(findings):
        if s.effect == new.effect and not {v.name for v in s.parameters} & {v.name for v in new.parameters}:
            both = replace(
                s, parameters=(*s.parameters, *new.parameters), axes=(*s.axes, *new.axes), nats=s.nats + new.nats
            )
            return [*findings[:k], both, *findings[k + 1 :]]
    return [*findings, new]


def _would_separate(members: Sequence[Member]) -> str:
    if len(members) < 2:
        return ""
    return "a longer drive with more changes of speed, height and heading, and with stops"
