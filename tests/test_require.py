"""Requirements turned round: closed forms of the errors, the answer, and what the command writes."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

import insemu as ins
from insemu import yamlfile
from insemu.cli import main
from insemu.errors import InputError
from insemu.evaluate import Experiment, LinearTwin, run_experiment
from insemu.require import (
    FIGURES,
    Answer,
    Question,
    Requirement,
    Sensor,
    Track,
    aids_of,
    completed,
    flights,
    quantile,
    require,
    scenario_of,
    track,
    wish_of,
)
from insemu.scenario import Scenario, Wish, first_scenario, validated
from insemu.sensors import card, names, of_text
from tests.budget import chi_square, chi_square_power, statistical

G = 9.81
NOTHING = Sensor("", np.zeros(len(FIGURES)), np.zeros(len(FIGURES)))
WISH = Wish(track="lemniscate", longest=240.0)
ASKED = "planimetric < 6 m at 95 % after 20 s"


def with_figure(name: str, value: float) -> Sensor:
    values = NOTHING.values.copy()
    values[FIGURES.index(name)] = value
    return replace(NOTHING, values=values)


@pytest.fixture(scope="module")
def question(tmp_path_factory: pytest.TempPathFactory) -> Question:
    return Question([ASKED], WISH, tmp_path_factory.mktemp("require") / "scenario.yaml")


@pytest.fixture(scope="module")
def free(tmp_path_factory: pytest.TempPathFactory) -> Track:
    """At rest, a known start and no fix that says anything: errors grow from time zero."""
    path = tmp_path_factory.mktemp("free") / "scenario.yaml"
    text = first_scenario(path, Wish(track="static", longest=60.0))
    track = Track.of(validated(Scenario, yamlfile.parse(text, "free")), path)
    return replace(track, start=np.zeros(9), sigma=np.full(6, np.inf))


@pytest.mark.parametrize(
    ("figure", "level", "metres"),
    [
        ("accel turn-on bias", 0.01, lambda t: 0.01 * t**2 / 2),
        ("accel white noise", 1e-3, lambda t: 1e-3 * t**1.5 / math.sqrt(3)),
        ("accel walk", 1e-4, lambda t: 1e-4 * t**2.5 / math.sqrt(20)),
        ("gyro turn-on bias", 1e-5, lambda t: G * 1e-5 * t**3 / 6),
        ("gyro white noise", 1e-5, lambda t: G * 1e-5 * t**2.5 / math.sqrt(20)),
        ("gyro walk", 1e-6, lambda t: G * 1e-6 * t**3.5 / math.sqrt(252)),
    ],
)
def test_errors_at_rest_grow_by_the_closed_forms(free: Track, figure: str, level: float, metres) -> None:
    C = free.covariances([with_figure(figure, level)], [20.0])[0][0, 0]
    end = free.t[free.starts(20.0)] + 20.0
    sigma = np.sqrt(0.5 * np.trace(C[:, :2, :2], axis1=1, axis2=2))
    # the table is tilted by 2 deg, the earth turns by 0.3 deg, and a Schuler period is 84 min
    np.testing.assert_allclose(sigma, metres(end), rtol=4e-3)


@pytest.mark.parametrize(("at", "per"), [(3, lambda t: t), (6, lambda t: G * t**2 / 2)], ids=["velocity", "tilt"])
def test_errors_of_the_start_grow_by_the_closed_forms(free: Track, at: int, per) -> None:
    start = np.zeros(9)
    start[at : at + 2] = 1e-3
    C = replace(free, start=start).covariances([NOTHING], [20.0])[0][0, 0]
    end = free.t[free.starts(20.0)] + 20.0
    np.testing.assert_allclose(np.sqrt(0.5 * np.trace(C[:, :2, :2], axis1=1, axis2=2)), 1e-3 * per(end), rtol=4e-3)


def test_scale_factors_act_by_what_the_axes_measure(free: Track) -> None:
    """At rest the accelerometers measure gravity: the height errs by s g t^2 / 2."""
    C = free.covariances([with_figure("accel scale factor", 1e-3)], [20.0])[0][0, 0]
    end = free.t[free.starts(20.0)] + 20.0
    np.testing.assert_allclose(np.sqrt(C[:, 2, 2]), 1e-3 * G * end**2 / 2, rtol=4e-3)


@pytest.mark.parametrize("name", ["STIM300", "ADIS16465", "HG1700"])
def test_the_covariance_is_that_of_the_filter(question: Question, name: str) -> None:
    """The linear twin carries every process sample by sample and all states of the flicker."""
    sensor = completed([Sensor.of_card(card(n)) for n in names()])[names().index(name)]
    text = scenario_of(question, sensor)
    scenario = validated(Scenario, yamlfile.parse(text, "flown"))
    first = scenario.gnss.outages[0]
    scenario = scenario.model_copy(update={"gnss": scenario.gnss.model_copy(update={"outages": (first,)})})
    twin = LinearTwin(Experiment(scenario, question.file))
    C = question.errors([sensor])[1][0, 0, 0]
    assert question.track.t[question.track.starts(20.0)[0]] == pytest.approx(first.start_s)
    # a state of the flicker that forgets in half a second is carried as white noise
    np.testing.assert_allclose(math.sqrt(C[0, 0] + C[1, 1]), twin.stated["complete"], rtol=5e-3)


def test_quantiles_are_those_of_their_distributions() -> None:
    one, zero = np.ones((1, 1)), np.zeros((1, 1))
    for share in (0.5, 0.95, 0.999):
        assert quantile(one, zero, share)[0] == pytest.approx(stats.norm.ppf(0.5 + share / 2), rel=1e-6)
        assert quantile(one, one, share)[0] == pytest.approx(math.sqrt(stats.chi2.ppf(share, 2)), rel=1e-6)
    # two starts of very different errors: half of all, and nine tenths of the larger one
    mixed = quantile(np.array([[1e-6, 100.0]]), np.array([[1e-6, 100.0]]), 0.95)[0]
    assert mixed == pytest.approx(10.0 * math.sqrt(stats.chi2.ppf(0.9, 2)), rel=1e-6)


def test_a_quantile_of_unequal_axes_holds_its_share() -> None:
    """The share within, by integration over the angle instead of over one axis."""
    large, small = 4.0, 0.3
    r = quantile(np.array([[large]]), np.array([[small]]), 0.95)[0]
    angle = np.linspace(0.0, 2 * np.pi, 20001)[:-1]
    g = np.cos(angle) ** 2 / large + np.sin(angle) ** 2 / small
    assert np.mean(-np.expm1(-0.5 * r**2 * g) / g) / math.sqrt(large * small) == pytest.approx(0.95, abs=1e-7)


@pytest.mark.parametrize(
    ("texts", "said"),
    [
        (["one metre please"], "expected a requirement such as"),
        (["planmetric < 1 m after 30 s"], "did you mean 'planimetric'"),
        (["planimetric < 1 deg after 30 s"], "dimension"),
        (["planimetric < -1 m after 30 s"], "positive limit"),
        (["planimetric < 1 m at 100 % after 30 s"], "between 0 and 100 %"),
        (["planimetric < 1 m after 0 s"], "expected 1 s to 3600 s"),
        (["planimetric < 1 m after 30 s", "planimetric < 2 m at 95 % after 30 s"], "contradicts"),
        ([], "no requirement"),
    ],
)
def test_requirements_that_say_nothing_are_refused(texts: list[str], said: str) -> None:
    with pytest.raises(InputError, match=said):
        require(texts, WISH, "scenario.yaml")


def test_what_no_sensor_can_keep_is_refused_by_name(question: Question) -> None:
    with pytest.raises(InputError, match=r"no inertial sensor keeps 'planimetric < 0.01 m at 95 % after 20 s'"):
        require(["planimetric < 1 cm after 20 s"], WISH, question.file)


def test_an_outage_longer_than_the_track_is_refused(question: Question) -> None:
    with pytest.raises(InputError, match="the track lasts 240 s"):
        require(["planimetric < 1 km after 230 s"], WISH, question.file)


def test_figures_that_no_source_prints_are_those_of_the_grade() -> None:
    sensors = [Sensor.of_card(card(n)) for n in names()]
    by_name = {s.name: s for s in completed(sensors)}
    at = FIGURES.index("gyro in-run bias")
    assert not sensors[names().index("LSM6DSV")].values[at]
    known = [s.values[at] for s in sensors if s.about.startswith("Consumer") and s.values[at]]
    assert by_name["LSM6DSV"].values[at] == pytest.approx(stats.gmean(known))
    assert by_name["LSM6DSV"].assumed[0].startswith("gyro in-run bias")
    assert not by_name["STIM300"].assumed


def test_a_card_gives_its_figures_with_their_spread() -> None:
    one = Sensor.of_card(
        of_text("ARW 0.3 deg/sqrt(h), scale factor 500 ppm, VRW 0.06 m/s/sqrt(h), scale factor 300 ppm")
    )
    value = dict(zip(FIGURES, one.values, strict=True))
    assert value["gyro white noise"] == pytest.approx(np.deg2rad(0.3) / 60)
    assert (value["gyro scale factor"], value["accel scale factor"]) == pytest.approx((5e-4, 3e-4))
    # twice the typical figure is what 95 % of the units keep
    assert stats.norm.cdf(math.log(2.0) / one.spread[0]) == pytest.approx(0.95, abs=1e-3)


@pytest.fixture(scope="module")
def answer(question: Question) -> Answer:
    return require([ASKED], WISH, question.file, aids="odometer=0.05 m/s")


def test_the_answer_orders_cards_and_names_what_limits_them(answer, question: Question) -> None:
    margins = [v.margin for v in answer.verdicts]
    assert margins == sorted(margins, reverse=True) and len(margins) == len(names())
    assert answer.text.startswith(f"{sum(v.word == 'meets' for v in answer.verdicts)} of {len(names())} cards meet")
    stim = answer["STIM300"]
    f = FIGURES.index(stim.limits)
    half = question.ratios([stim.sensor.times_factor(f, 0.5)])[0]
    assert stim.halved == pytest.approx(1.0 / half) and stim.halved > stim.margin
    others = [question.ratios([stim.sensor.times_factor(k, 0.5)])[0] for k in np.flatnonzero(stim.sensor.values)]
    assert half == pytest.approx(min(others))


def test_a_probability_is_the_share_of_units_within_the_limit(question: Question) -> None:
    """One figure, whose power on the error is known: units within the limit are those within a factor."""
    sensor = replace(with_figure("gyro white noise", 1e-4), spread=np.full(len(FIGURES), 0.5))
    limit = question.errors([sensor])[0][0, 0] * 1.2
    own = Question([f"planimetric < {limit} m after 20 s"], WISH, question.file)
    from insemu.require.answer import _verdicts

    verdict = _verdicts(own, [sensor])[0][0]
    power = math.log2(question.ratios([sensor])[0] / question.ratios([sensor.times_factor(0, 0.5)])[0])
    expected = stats.norm.cdf(math.log(1.2) / (0.5 * power))
    assert verdict.probability == pytest.approx(expected, abs=4 * math.sqrt(expected * (1 - expected) / 4000))


def test_figures_that_just_do_keep_the_requirement(answer, question: Question) -> None:
    alone = {k: v for k, v in answer.alone.items() if math.isfinite(v)}
    assert "gyro white noise" in alone
    sensors = [with_figure(k, v) for k, v in alone.items()]
    np.testing.assert_allclose(question.ratios(sensors), 1.0, rtol=0.05)  # between two values of the grid
    together = NOTHING.values.copy()
    for k, v in answer.just.items():
        together[FIGURES.index(k)] = v if math.isfinite(v) else 0.0
    assert question.ratios([replace(NOTHING, values=together)])[0] == pytest.approx(1.0, rel=0.05)
    for (x, y), curve in answer.planes.items():
        for a, b in curve:
            changed = together.copy()
            changed[[FIGURES.index(x), FIGURES.index(y)]] = a, b
            assert question.ratios([replace(NOTHING, values=changed)])[0] == pytest.approx(1.0, rel=0.1)


def test_an_aid_helps_and_is_worth_a_better_card(answer) -> None:
    none, odometer = answer.alternatives
    assert all(odometer.margins[n] > none.margins[n] for n in none.margins)
    least = min(odometer.margins.values())
    assert none.margins[odometer.like] == pytest.approx(
        min(none.margins.values(), key=lambda m: abs(math.log(m / least)))
    )


def test_all_and_none_are_said_with_what_would_change_it(question: Question) -> None:
    assert "Every card meets" in require(["planimetric < 100 km after 20 s"], WISH, question.file).text
    perfect = question.errors([NOTHING])[0][0, 0]
    best = min(question.errors(completed([Sensor.of_card(card(n)) for n in names()]))[0][0])
    few = require([f"planimetric < {math.sqrt(perfect * best)} m after 20 s"], WISH, question.file)
    assert few.text.startswith("No card meets") and "would" in few.text


def test_a_doubtful_card_is_flown_where_asked(question: Question) -> None:
    """Its turn-on bias turns it by 20 deg before the first fix, after which the filter is lost."""
    from insemu.require.answer import _flown, _verdicts

    (verdict,), _ = _verdicts(question, [Sensor.of_card(card("MPU-6000"))])
    assert verdict.word == "doubtful" and "deg only" in verdict.doubt
    flown = _flown(question, verdict, 4)
    sizes = np.linalg.norm(flights(question, verdict.sensor, 4)[..., :2], axis=-1)
    assert flown.errors == pytest.approx((np.quantile(sizes, 0.95),)) and flown.errors[0] > 10 * verdict.errors[0]
    assert flown.word == "misses" and flown.flown == 4
    (sound,), _ = _verdicts(question, [Sensor.of_card(card("STIM300"))])
    assert not sound.doubt


def test_what_was_computed_is_kept_unless_it_is_damaged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(track, "own_folder", lambda: tmp_path)
    monkeypatch.setattr(track, "MOST_KEPT", 2)
    made = []

    def make() -> dict[str, np.ndarray]:
        made.append(1)
        return {"x": np.arange(3.0)}

    for _ in range(2):
        np.testing.assert_array_equal(track.kept("one", [1], make)["x"], np.arange(3.0))
    assert len(made) == 1
    next(tmp_path.rglob("*.npz")).write_bytes(b"PK damaged")
    track.kept("one", [1], make)
    assert len(made) == 2
    for k in range(4):
        track.kept("other", [k], make)
    assert len(list(tmp_path.rglob("*.npz"))) == 2


def test_factors_between_bench_and_vehicle_are_put_on_all_cards(question: Question, tmp_path: Path) -> None:
    file = tmp_path / "transfer.json"
    factor = {"name": "gyro white", "value": 3.0, "low": 2.0, "high": 4.5, "told": True}
    file.write_text(json.dumps({"factors": [factor, factor | {"name": "accel slow", "told": False}]}))
    found = require([ASKED], WISH, question.file, road=file)
    plain = Sensor.of_card(card("STIM300"))
    assert found["STIM300"].sensor.values[0] == pytest.approx(3.0 * plain.values[0])
    assert found["STIM300"].sensor.values[1:] == pytest.approx(plain.values[1:])
    assert dict(found.road) == {"gyro white noise": 3.0}
    file.write_text("{}")
    with pytest.raises(InputError, match="insemu transfer --json"):
        require([ASKED], WISH, question.file, road=file)


def test_aids_that_do_not_exist_are_refused() -> None:
    assert set(aids_of("odometer=0.05 m/s, standstill")) == {"odometer", "standstill"}
    for text in ("odometer", "radar=1 m", "odometer=1 deg"):
        with pytest.raises(InputError):
            aids_of(text)


def test_standing_still_helps_where_the_vehicle_stands(question: Question) -> None:
    sensors = [Sensor.of_card(card("STIM300"))]
    plain, still = (question.errors(sensors, a)[1][0, 0] for a in ({}, {"standstill": None}))
    assert np.all(np.trace(still, axis1=1, axis2=2) <= np.trace(plain, axis1=1, axis2=2) * (1 + 1e-9))
    assert np.trace(still[0]) < np.trace(plain[0])  # it stood for twenty seconds at the start


@statistical(2e-5, 1, power=chi_square_power(2 * 64, 2e-5, 1, 2.0))  # the errors believed are half of those that happen
def test_the_scenario_flies_the_answer(answer, question: Question) -> None:
    """The flown error over its covariance, one outage a flight so that errors are independent."""
    scenario = validated(Scenario, yamlfile.parse(answer.scenario, str(question.file)))
    first, designs = scenario.gnss.outages[0], {"complete": scenario.designs["complete"]}
    alone = scenario.gnss.model_copy(update={"outages": (first,)})
    cut = scenario.trajectory.model_copy(update={"duration": first.start_s + first.duration_s + 1.0})
    scenario = scenario.model_copy(update={"designs": designs, "gnss": alone, "trajectory": cut, "seed": 5})
    results = run_experiment(Experiment(scenario, question.file), realizations=64)
    C = question.errors([answer.chosen.sensor])[1][0, 0, 0][:2, :2]
    errors = np.asarray(results.total.runs["end_error"])[0][:, 0, :2]
    square = np.einsum("ri,ij,rj->", errors, np.linalg.inv(C), errors) / (2 * 64)
    low, high = chi_square(2 * 64, 2e-5)
    assert low < square < high


def done(arguments: list[str]) -> None:
    with pytest.raises(SystemExit) as left:
        main(arguments)
    assert left.value.code == 0


def test_the_command_writes_page_json_and_scenario(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    done(
        [
            "require",
            ASKED,
            "--track",
            "lemniscate",
            "--fixes",
            "2 cm, 3 cm/s",
            "--have",
            "BMI088",
            "--output",
            str(out),
            "--json",
        ]
    )
    found = json.loads(capsys.readouterr().out)
    assert found == json.loads((out / "require.json").read_text()) and found["chosen"] == "BMI088"
    assert "position_sigma: [0.02 m, 0.02 m, 0.04 m]" in (out / "scenario.yaml").read_text()
    page = (out / "index.html").read_text(encoding="utf-8")
    assert found["answer"].replace("<", "&lt;") in page and "BMI088" in page
    done(
        ["run", str(out / "scenario.yaml"), "--realizations", "2", "--no-pictures", "--output", str(tmp_path / "flown")]
    )
    assert (tmp_path / "flown" / "summary.json").is_file()


@pytest.mark.parametrize(
    "arguments",
    [["planimetric < 1 m"], [ASKED, "--have", "NOSUCH"], [ASKED, "--fixes", "2 cm"], [ASKED, "--track", "nosuch.gpx"]],
)
def test_a_refused_command_writes_nothing(
    arguments: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as left:
        main(["require", *arguments, "--output", str(tmp_path / "out")])
    assert left.value.code == 2 and not (tmp_path / "out").exists()
    assert capsys.readouterr().err.startswith("insemu: error:")


def test_the_function_at_the_top_gives_the_answer() -> None:
    found = ins.require("heading < 5 deg after 20 s", track="lemniscate", fixes="2 cm, 3 cm/s")
    assert found.requirements == (Requirement("heading", math.radians(5.0), 0.95, 20.0),)
    assert str(found).startswith(found.text) and wish_of().position == "1 m, 1 m, 2 m"
