"""The library as a script sees it: names at the top, quantities as text, results that show themselves, own processes and filters."""

from __future__ import annotations

import ast
import inspect
import json
import re
import subprocess
import sys
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, ClassVar, get_overloads

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest

import insemu as ins
from insemu.cli import main
from insemu.errors import InputError
from insemu.filters import user_filter, user_filter_code
from insemu.filters.protocol import REGISTERED
from insemu.formats import write
from insemu.noise import PROCESSES, Parameter, StateBlock
from insemu.report.charts import Chart, Line, View
from insemu.report.gap_charts import evidence_chart
from insemu.report.static import draw


@pytest.fixture(scope="module")
def series() -> ins.Series:
    model = ins.WN(N="0.34 deg/sqrt(h)") + ins.GM(sigma="20 deg/h", Tc="30 s")
    return ins.Series(model.simulate(20_000, 0.01, np.random.default_rng(1)), 100.0, "rad/s", "gyro_x")


def test_names_at_the_top_are_found_when_asked_for() -> None:
    said = "import sys, insemu as ins; print('scipy' in sys.modules, ins.WN.__name__, type(ins.fit).__name__)"
    said += "; from insemu.fit import FitResult; import insemu.fit, insemu.solve; print(type(ins.fit).__name__, ins.solve.__module__)"
    done = subprocess.run([sys.executable, "-c", said], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False", "WN", "function", "function", "insemu.api"]
    for name in ins.__all__:
        assert getattr(ins, name) is not None
    assert set(dir(ins)) == set(ins.__all__)
    with pytest.raises(AttributeError, match="no attribute 'fitt'"):
        ins.fitt  # noqa: B018


def test_every_name_at_the_top_has_a_type() -> None:
    tree = ast.parse((Path(ins.__file__).parent / "__init__.pyi").read_text(encoding="utf-8"))
    typed = {a.asname for node in tree.body if isinstance(node, ast.ImportFrom) for a in node.names if a.asname}
    typed |= {
        t.id for node in tree.body if isinstance(node, ast.Assign) for t in node.targets if isinstance(t, ast.Name)
    }
    made = {node.name: node.body[0] for node in tree.body if isinstance(node, ast.ClassDef)}
    assert set(ins.__all__) - {"__version__"} == {n for n in typed | set(made) if not n.startswith("_")}
    for name, init in made.items():
        assert isinstance(init, ast.FunctionDef)
        own = {f.name for f in fields(getattr(ins, name))}
        assert {a.arg for a in (*init.args.args[1:], *init.args.kwonlyargs)} - {"Tc"} == own, name
    for function in (ins.fit, ins.select, ins.characterise, ins.find_gap, ins.solve, ins.run, ins.emulate):
        assert all(p.kind is not p.VAR_KEYWORD for p in inspect.signature(function).parameters.values())
    with pytest.raises(TypeError, match="rate_hz"):
        ins.fit(np.zeros(64), "WN()", rate_hz=100)  # type: ignore[call-overload]


EXAMPLES = """
import numpy as np
import insemu as ins
model = ins.WN(N="0.3 deg/sqrt(h)") + ins.GM(sigma="3 deg/h", Tc="40 s")
reveal_type(model)
reveal_type(ins.fit("log.npz", "2*GM() + WN()")["gyro_z"])
reveal_type(ins.fit(np.zeros((64, 2)), model)["WN1.N"].value)
reveal_type(ins.select("log.npz")["gyro_z"])
reveal_type(ins.characterise(np.zeros(64), rate="100 Hz"))
reveal_type(ins.run("scenario.yaml").to_xarray())
reveal_type(ins.emulate("scenario.yaml", realization=1))
reveal_type(ins.find_gap({"gyro_x": model}, "log.npz"))
reveal_type(ins.solve("town.npz", lever_arm=(0.0, 0.0, 1.0)))
"""


#: Examples of pages, as marked blocks or prompts of Python.
BLOCK = re.compile(r"^```(?:python|py|\{code-block\} python\n(?::.*\n)*)\n(.*?)^```", re.S | re.M)


@pytest.mark.slow(reason="reads the types of the whole package, a minute without mypy's cache")
def test_a_type_checker_knows_what_the_functions_return_and_all_examples_of_the_docs(tmp_path: Path) -> None:
    root = Path(ins.__file__).resolve().parent.parent
    (tmp_path / "examples.py").write_text(EXAMPLES)
    for page in (root / "README.md", *(root / "docs").rglob("*.md")):
        if blocks := BLOCK.findall(page.read_text(encoding="utf-8")):
            (tmp_path / f"page_{page.stem}.py").write_text("\n\n".join(blocks), encoding="utf-8")
    written = [*tmp_path.glob("*.py"), *(root / "docs/gallery").glob("*.py")]
    assert len(written) > 25
    done = subprocess.run(
        [sys.executable, "-m", "mypy", "--strict", *map(str, written)],
        cwd=root,
        capture_output=True,
        text=True,
    )
    said = [line.split("Revealed type is ")[1] for line in done.stdout.splitlines() if "Revealed type is " in line]
    assert done.returncode == 0 and len(said) == EXAMPLES.count("reveal_type"), done.stdout
    assert not [line for line in said if "Any" in line]


def test_overloads_of_fit_have_its_keywords_and_name_others() -> None:
    """Checkers hide a misspelled keyword behind overloads; the last one takes it as a value that cannot be."""
    own = inspect.signature(ins.fit).parameters
    *first, last = ([p for p in inspect.signature(f).parameters.values()] for f in get_overloads(ins.fit))
    assert [[(p.name, p.kind, p.default) for p in each] for each in (*first, last[:-1])] == [
        [(p.name, p.kind, p.default) for p in own.values()]
    ] * 2
    assert last[-1].kind is inspect.Parameter.VAR_KEYWORD and last[-1].annotation == "Never"


def test_what_goes_by_file_goes_by_object(tmp_path: Path, series: ins.Series) -> None:
    x = series.values[:2000]
    t = np.arange(x.size) / 100.0
    table = pd.DataFrame({"time [s]": t, "gx [deg/h]": np.degrees(x) * 3600.0})
    table.to_csv(tmp_path / "log.csv", index=False)
    by_file = ins.fit(tmp_path / "log.csv", "WN()")["gyro_x"]
    by_table = ins.fit(table.set_index("time [s]"), "WN()")["gyro_x"]
    assert by_table["WN1.N"].value == by_file["WN1.N"].value
    by_array = ins.fit(np.column_stack([t, x]), "WN()", unit="rad/s")
    assert by_array["WN1.N"].value == pytest.approx(by_file["WN1.N"].value, rel=1e-9)  # deg/h and back
    given = ins.fit(x, "WN()", rate="100 Hz", unit="rad/s")
    assert given["WN1.N"].value == pytest.approx(by_array["WN1.N"].value, rel=1e-12)
    for data in (table, np.column_stack([t, x])):
        (report,) = ins.characterise(data).values()
        assert report.samples == x.size and report.rate_hz == pytest.approx(100.0)
    with pytest.raises(InputError, match="sampling rate; expected rate="):
        ins.fit(x, "WN()")
    with pytest.raises(InputError, match="gaps"):
        ins.fit(np.column_stack([np.where(t > 5.0, t + 3.0, t), x]), "WN()")
    with pytest.raises(InputError, match="no column 'gyro_q'"):
        ins.fit(series, "WN()", columns=["gyro_q"])


def test_the_model_stands_before_the_recording() -> None:
    imu = ins.ImuRecord(np.arange(9) / 9.0, np.zeros((9, 3)), np.zeros((9, 3)))
    with pytest.raises(InputError, match="expected the model first"):
        ins.find_gap(ins.Recording(imu), "model.yaml")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="of gyro_x is a WN, expected a NoiseModel"):
        ins.find_gap({"gyro_x": ins.noise.WN(1e-4)}, ins.Recording(imu))
    with pytest.raises(InputError, match="is a WN, expected a path"):
        ins.find_gap(ins.noise.WN(1e-4), ins.Recording(imu))
    with pytest.raises(InputError, match="expected -pi/2 to pi/2 rad"):
        ins.GnssRecord(np.arange(2.0), np.array([[46.0, 7.0, 400.0], [46.1, 7.1, 400.0]]))


def test_quantities_are_text_of_a_gyroscope_or_of_an_accelerometer() -> None:
    assert ins.WN(N="0.34 deg/sqrt(h)").N == pytest.approx(np.deg2rad(0.34) / 60.0)
    assert ins.WN(N="60 ug/sqrt(Hz)").N == pytest.approx(60e-6 * 9.80665)
    assert ins.GM(sigma="20 deg/h", Tc="30 s").beta == pytest.approx(1 / 30)
    with pytest.raises(InputError, match="text with a unit"):
        ins.WN(N="0.34 kg")
    with pytest.raises(InputError, match="both beta and Tc"):
        ins.GM(beta=1.0, Tc=1.0)


def test_results_print_in_ten_lines_and_have_tables_and_charts(series: ins.Series) -> None:
    results = {
        "fit": ins.fit(series, "WN() + GM()"),
        "axes": ins.fit([series], "WN()"),
        "report": ins.characterise([series])["gyro_x"],
        "ranking": ins.select([series], "WN() + GM()")["gyro_x"],
    }
    for name, result in results.items():
        assert 1 <= len(str(result).splitlines()) <= 10 and repr(result) == str(result), name
        assert "gyro_x" in str(result)
        assert len(result.to_dataframe()) >= 1 and "<table" in result._repr_html_()
        figure, axes = plt.subplots()
        assert result.plot(axes) is axes and axes.lines and axes.get_xscale() == "log"
        plt.close(figure)
    plt.close(results["fit"].plot())
    with pytest.raises(InputError, match="no view"):
        results["fit"].plot(plt.gca(), view="gyro")
    plt.close("all")
    assert results["fit"].to_dataframe().loc["WN1.N", "value"] == results["fit"]["WN1.N"].value


def test_a_run_and_an_emulation_from_plain_data() -> None:
    scenario = {
        "title": "t",
        "trajectory": {"builtin": "helicopter_mapping", "rate": "50 Hz", "duration": "60 s"},
        "truth": {"gyro": "WN(N=0.03 deg/s/sqrt(Hz))", "accel": "WN(N=90 ug/sqrt(Hz))"},
        "gnss": {"position_sigma": "5 cm", "outages": [{"start": "40 s", "duration": "10 s"}]},
        "designs": {"white": {"gyro": {"truth": True}, "accel": {"truth": True}}},
    }
    results = ins.run(scenario, realizations=2, seed=4)
    assert results.realizations == 2 and results.seed == 4 and results.to_xarray()["error"].sizes["realization"] == 2
    assert "white, outage 1:" in str(results) and results.to_dataframe().index.names == ["design", "outage"]
    recording = ins.emulate(scenario, seed=4)
    assert len(recording.imu) == 3001 and not np.array_equal(
        recording.imu.gyro, ins.emulate(scenario, seed=4, ideal=True).imu.gyro
    )
    with pytest.raises(InputError, match="titel"):
        ins.run(scenario | {"titel": "x"})


@pytest.mark.slow(reason="whole commands, whose parts have quick tests")
def test_a_recording_is_solved_at_the_top_as_by_the_command(tmp_path: Path) -> None:
    scenario = {
        "title": "t",
        "trajectory": {"builtin": "helicopter_mapping", "rate": "20 Hz", "duration": "100 s"},
        "truth": {"gyro": "WN(N=0.02 deg/s/sqrt(Hz))", "accel": "WN(N=300 ug/sqrt(Hz))"},
        "gnss": {"position_sigma": "20 cm", "velocity_sigma": "5 cm/s"},
    }
    recording = ins.emulate(scenario, seed=4)
    write(tmp_path / "flight.npz", recording)
    solution = ins.solve(tmp_path / "flight.npz", designs=["18AV"], lever_arm=(0.0, 0.0, 0.0))
    assert "18AV" in solution.to_dataframe().index.unique("design")
    with pytest.raises(SystemExit) as end:
        options = ["--designs", "18AV", "--lever-arm", "0 0 0 m", "--output", str(tmp_path / "solved")]
        main(["solve", str(tmp_path / "flight.npz"), *options])
    assert end.value.code in (0, None)
    said = json.loads((tmp_path / "solved" / "summary.json").read_text())
    assert [o["rms_m"] for o in said["taken"]["outages"][:2]] == [
        o["rms_m"] for o in solution.taken.figures()["outages"][:2]
    ]
    assert 3 < len(str(solution).splitlines()) <= 10 and "30 s without GNSS" in repr(solution)
    figure, axes = plt.subplots()
    assert solution.plot(axes, view="After 30 s") is axes and len(axes.lines) >= 2
    plt.close(figure)
    with pytest.raises(InputError, match="belong to a file"):
        ins.solve(recording, gnss="fixes.pos")


@dataclass(frozen=True)
class Twice(ins.Process):
    """White noise, said twice."""

    PARAMETERS: ClassVar[tuple[Parameter, ...]] = (Parameter("N", "{u}/sqrt(Hz)", "positive", "density"),)
    N: float | None = None

    def block(self, dt: float) -> StateBlock:
        return ins.WN(N=self.N).block(dt)


def test_a_process_of_a_script_is_known_to_text(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in list(PROCESSES):
        monkeypatch.setitem(PROCESSES, name, PROCESSES[name])
    monkeypatch.delitem(PROCESSES, "Twice", raising=False)
    with pytest.raises(InputError, match="Twice"):
        ins.NoiseModel.parse("Twice(N=1)")
    assert ins.register_process(Twice) is Twice
    assert ins.NoiseModel.parse("Twice(N=0.34 deg/sqrt(h))", "rad/s").psd(1.0, 0.01) == pytest.approx(
        np.deg2rad(0.34 / 60) ** 2
    )
    ins.register_process(Twice)  # a cell that is run again
    with pytest.raises(InputError, match="there is a process WN"):
        ins.register_process(type("WN", (Twice,), {}))
    with pytest.raises(InputError, match="expected a subclass"):
        ins.register_process(int)  # type: ignore[arg-type]


def test_a_filter_of_a_script_is_known_by_its_name(monkeypatch: pytest.MonkeyPatch) -> None:
    class Mine:
        def run(self, *_: Any) -> None: ...

    monkeypatch.setitem(REGISTERED, "mine_here", Mine)  # gone after the test
    ins.register_filter("mine_here", Mine)  # type: ignore[arg-type]
    assert user_filter("mine_here") is Mine
    assert list(user_filter_code("mine_here").values()) == [Path(__file__)]
    for name, offered, words in (("reference", Mine, "comes with insemu"), ("x", int, "no method run")):
        with pytest.raises(InputError, match=words):
            ins.register_filter(name, offered)  # type: ignore[arg-type]


def test_names_below_the_bars_of_evidence_stand_in_the_static_picture() -> None:
    rivals = [("time offset", 206.0, True), ("clock drift", 116.0, False)]
    figure = draw(evidence_chart([("time offset", rivals)]))
    assert [label.get_text() for label in figure.axes[0].get_xticklabels()] == ["time\noffset", "clock\ndrift"]
    rivals += [("Gauss-Markov process (bias instability)", 40.0, False)]
    slanted = draw(evidence_chart([("time offset", rivals)])).axes[0].get_xticklabels()[-1]
    assert slanted.get_text() == "Gauss-Markov process (bias instability)" and slanted.get_rotation() > 0
    plt.close("all")


def test_decades_are_plain_text_and_titles_keep_clear_of_the_factor_of_the_labels() -> None:
    x = np.arange(3.0)
    views = [
        View("decades", "m", [Line("a", [0.02, 5.0, 700.0], "#000000")], log_y=True),
        View("tiny", "m", [Line("a", [1e-9, 2e-9, 3e-9], "#000000")]),
        View("a name that takes two rows of a title above its panel", "m", [Line("a", x, "#000000")]),
    ]
    figure = draw(Chart("three", "", x, "s", views))
    figure.draw_without_rendering()
    decades, tiny, long = figure.axes
    low, high = decades.get_ylim()
    shown = [t.get_text() for t in decades.get_yticklabels() if low <= t.get_position()[1] <= high]
    assert shown == ["10⁻¹", "10⁰", "10¹", "10²", "10³"]
    assert tiny.yaxis.get_offset_text().get_text() == "1e\N{MINUS SIGN}9"
    for axes, below in ((tiny, tiny.yaxis.get_offset_text()), (long, long)):
        (title,) = (t for t in axes.get_children() if getattr(t, "get_text", str)() == axes.get_title(loc="left"))
        assert title.get_window_extent().y0 >= below.get_window_extent().y1
    plt.close("all")
