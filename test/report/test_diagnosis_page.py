"""A diagnosis as page, tables and files: all that was found is there, nothing is asked of the network, any width."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from browser import Browser
from report.diagnosis_case import case
from rich.console import Console

from artibot_sim.cli import main
from artibot_sim.diagnose.records import (
    Candidate,
    Cause,
    ChannelBaseline,
    EffectEstimate,
    ErrorBudget,
    Unexplained,
    Varies,
)
from artibot_sim.diagnose.result import Diagnosis
from artibot_sim.diagnose.verdict import Verdict
from artibot_sim.diagnose.words import amount, channel_words, effect_words, force_words
from artibot_sim.errors import ArtibotError
from artibot_sim.model import load_robot
from artibot_sim.model.effects import EFFECTS
from artibot_sim.report.diagnosis import sentences
from artibot_sim.report.diagnosis.charts import law_curve, path, windows
from artibot_sim.report.diagnosis.files import files_of, load
from artibot_sim.report.diagnosis.page import page_of
from artibot_sim.report.diagnosis.terminal import printed
from artibot_sim.report.files import write_folder

SLOPE: dict[str, float | str] = {"grade": 0.05, "heading": 1.2}


@pytest.fixture(scope="module")
def named() -> Diagnosis:
    return case("slope", SLOPE)


@pytest.fixture(scope="module")
def every(named: Diagnosis) -> dict[Verdict, Diagnosis]:
    """A diagnosis of each verdict."""
    found = {verdict: case("slope", SLOPE, verdict) for verdict in (Verdict.AMBIGUOUS, Verdict.UNEXPLAINED)}
    return {Verdict.NAMED: named, **found, Verdict.NONE: case("", {}, Verdict.NONE)}


def markup(found: Diagnosis) -> str:
    """The page without its scripts."""
    return re.sub(r"<script>.*?</script>", "", page_of(found, "0").decode(), flags=re.S)


def as_text(found: Diagnosis) -> str:
    """What the terminal shows."""
    console = Console(width=118, highlight=False)
    with console.capture() as shown:
        console.print(printed(found))
    return shown.get()


def test_held_out_errors_are_said_channel_by_channel(named: Diagnosis) -> None:
    """On a Husky the position gained a quarter and the heading nothing sure: one sum of both said worse."""
    position, other = named.gain["position"], next(one for one in named.baseline if one != "position")
    assert "Held-out errors with it: position −" in sentences.sureness(named)
    better = replace(position, before=0.20, after=0.15, ci95=(0.03, 0.07))
    error = 10.0 * named.baseline[other].noise
    unsure = replace(position, before=error, after=1.05 * error, ci95=(-0.1 * error, 0.01 * error))
    said = sentences.sureness(replace(named, gain={"position": better, other: unsure}))
    assert f"position −25 %, {channel_words(other)} +5 % (not sure)." in said
    worse = replace(position, before=error, after=1.25 * error, ci95=(-0.4 * error, -0.1 * error))
    assert f"{channel_words(other)} +25 %." in sentences.sureness(replace(named, gain={other: worse}))


def test_a_channel_within_its_noise_has_no_error_to_lose(named: Diagnosis) -> None:
    within = replace(named.gain["position"], before=0.5 * named.baseline["position"].noise)
    assert "Held-out errors" not in sentences.sureness(replace(named, gain={"position": within}))


def test_held_out_evidence_of_causes_is_summed(named: Diagnosis) -> None:
    """Of a Warthog on asphalt the first cause alone predicted worse, and both together far better."""
    (cause, *_) = named.causes
    first = replace(cause, holdout_log10_likelihood=3.0)
    second = replace(cause, effect="payload", holdout_log10_likelihood=40.0)
    both = replace(named, causes=(first, second))
    for likelier, words in (
        (None, "10⁴³ to 1."),
        ((20.0, 70.0), "10⁴³ to 1 (surely: at least 10²⁰ to 1)."),
        ((-5.0, 90.0), "10⁴³ to 1 (not sure)."),
    ):
        assert f"speak for them, {words}" in sentences.sureness(replace(both, holdout_likelier=likelier))


@pytest.mark.parametrize(
    ("effect", "rival", "scale"), [("encoder_scale", "wheel_radius", 1.05), ("wheel_radius", "encoder_scale", 1 / 1.05)]
)
def test_a_tape_tells_an_encoder_scale_from_a_radius(named: Diagnosis, effect: str, rival: str, scale: float) -> None:
    (first, *_) = named.causes
    alone = Cause(effect, {"scale": EffectEstimate(scale, "-", (0.99 * scale, 1.01 * scale))}, 60.0, 0.8)
    tied = replace(alone, ties=(rival,))
    radius = named.robot.wheel.r_w / 1.05
    for verdict, causes in ((Verdict.NAMED, (first, tied)), (Verdict.AMBIGUOUS, (tied,))):
        said = replace(named, verdict=verdict, causes=causes, next_experiment=None)
        first_name, second_name = effect.replace("_", " "), rival.replace("_", " ")
        assert f"either {first_name} or {second_name}" in sentences.headline(said).lower()
        assert f"put {radius:.3f} m into wheel.r_w" in sentences.next_step(said)
    assert "r_w" not in sentences.next_step(replace(named, causes=(alone,), next_experiment=None))


def test_the_first_sentence_names_cause_size_and_gain(every: dict[Verdict, Diagnosis]) -> None:
    said = {verdict: sentences.headline(found) for verdict, found in every.items()}
    assert said[Verdict.NAMED].startswith("Slope: grade 0.0500 rad (2.9°), heading 1.20 rad (69°). With it, ")
    before, after = (every[Verdict.NAMED].gain["position"].__dict__[k] for k in ("before", "after"))
    assert f"instead of {amount(before, 'm')}" in said[Verdict.NAMED]
    assert f"by {amount(after, 'm')}" in said[Verdict.NAMED]
    assert said[Verdict.AMBIGUOUS].startswith("Either slope or external force: these recordings cannot tell")
    assert "on no list: a front yaw moment of 12 N·m that follows yaw rate" in said[Verdict.UNEXPLAINED]
    assert said[Verdict.NONE].startswith("No effect explains")


def test_what_is_sure_is_said_beside_what_ties(every: dict[Verdict, Diagnosis]) -> None:
    """The strongest cause may tie with another effect: the others are no less sure for that."""
    tied = every[Verdict.AMBIGUOUS]
    sure = replace(
        tied.causes[0], effect="payload", parameters={"mass": EffectEstimate(4.0, "kg", (3.0, 5.0))}, ties=()
    )
    both = replace(tied, causes=(*tied.causes, sure))
    said = sentences.headline(both)
    assert said.startswith("Payload: mass 4.00 kg; and either slope or external force: these recordings cannot tell")
    assert "which, extended.yaml has slope. With them, predictions" in said
    assert "cause found, another one ties" in markup(both) and "several causes tie" in markup(tied)
    named = replace(both, verdict=Verdict.NAMED, causes=(sure, *tied.causes))
    assert sentences.headline(named) == said and "cause found, another one ties" in markup(named)
    assert sentences.next_step(named).endswith("Drive an eight of 2 m radius.")
    many = replace(named, causes=(sure, *(replace(sure, effect=one) for one in ("stribeck", "slope", "torque_scale"))))
    said = sentences.next_step(many)
    assert "payload" in said and "then what the other 3 causes claim" in said and "Stribeck" not in said


def test_evidence_of_some_windows_is_not_shown_as_that_of_all(named: Diagnosis) -> None:
    """Long recordings are searched in some windows; evidence grows with their number."""
    first, second, *rest = named.ranking
    some = replace(named, ranking=(first, replace(second, windows=0.25), *rest))
    assert "of the windows" not in as_text(named) + markup(named)
    assert sentences.sureness(some).count("25 % of the windows") == 1
    shares = re.findall(r"(\d+) % *$", as_text(some).partition("Parameters")[0], re.M)
    assert set(shares) == {"100", "25"} and shares.count("25") == 1
    assert markup(some).count("25 % of the windows") == 2  # the head, and the table


def test_what_is_on_no_list_is_told_where_it_shows(every: dict[Verdict, Diagnosis]) -> None:
    found = every[Verdict.UNEXPLAINED]
    torque = ChannelBaseline("N m", 0.07, 0.02, 0.07)
    still = replace(
        found, gain={}, baseline={"position": ChannelBaseline("m", 0.006, 0.004, 0.006), "torque_back": torque}
    )
    assert "miss the back motors' torque by 0.070 N·m; the sensor's noise is 0.020 N·m" in sentences.headline(still)
    lost = replace(still, baseline={"position": ChannelBaseline("m", 0.2, 0.004, 0.5), "torque_back": torque})
    assert "miss the position by 20 cm" in sentences.headline(lost)
    assert "miss the position by 6.0 mm" in sentences.headline(replace(still, verdict=Verdict.NONE))
    jumps = replace(still, baseline={"position": ChannelBaseline("m", 0.006, 0.004, 0.006, 0.9)}, verdict=Verdict.NONE)
    assert sentences.headline(jumps).endswith("in all the error is no more than noise.")


def test_effects_beyond_the_dotted_line_have_their_reason_on_the_first_screen(every: dict[Verdict, Diagnosis]) -> None:
    """A picture in which bars pass the line, and a sentence which names nothing, contradict each other."""
    strong = [
        Candidate("com_offset", 60.0, {}, note="167 nats are asked of it", fitted=True),
        Candidate("payload", 30.0, {}, note="", fitted=False), Candidate("stribeck", 1.0, {}, note="", fitted=True),
    ]  # fmt: skip
    none = replace(every[Verdict.NONE], ranking=tuple(strong), threshold=58.0)
    head = markup(none).partition("<main>")[0]
    assert "com offset (167 nats are asked of it); payload (only screened" in head
    assert "stribeck" not in sentences.not_named(none)
    assert sentences.not_named(none) in " ".join(as_text(none).split())
    assert not sentences.not_named(replace(none, ranking=tuple(strong[2:])))
    beside = replace(every[Verdict.NAMED], ranking=(*every[Verdict.NAMED].ranking, strong[1]), threshold=25.0)
    assert "payload (explained better by slope)" in sentences.not_named(beside)
    assert "slope (" not in sentences.not_named(beside)


def test_the_error_is_said_in_parts(every: dict[Verdict, Diagnosis]) -> None:
    """What is below half a per cent is left out, and so is a channel that its noise explains."""
    base = {
        "position": ChannelBaseline("m", 0.2, 0.02, 0.3, 10.0),
        "yaw": ChannelBaseline("rad", 0.01, 0.01, 0.02, 1.0),
    }
    budget = ErrorBudget(0.25, 0.05, 0.001, 0.4, 0.0, 0.299)
    varies = Varies("", "mu_d", 0.22, (0.49, 0.77), 835.0, (650.0, 1027.0), ("k_t",))
    found = replace(
        every[Verdict.NAMED], baseline=base, error_budget={"position": budget, "yaw": budget}, varies=varies
    )
    assert sentences.budget_words(found) == (
        "of the squared error of held-out predictions, position: 25 % what is named takes away, "
        "5 % noise of the sensor, 40 % ground that varies, 30 % unknown."
    )
    assert sentences.varies_words(found).startswith("from window to window mu_d or k_t has another value, by ±22 % ")
    assert sentences.budget_words(replace(found, error_budget={})) == ""
    over = {
        "time": "alike for some 40 s",
        "place": "alike within some 40 m",
        "recording": "from recording to recording",
    }
    for name, words in over.items():
        assert words in sentences.varies_words(replace(found, varies=replace(varies, over=name, length=40.0)))


def test_what_varies_comes_back_from_the_file(every: dict[Verdict, Diagnosis], tmp_path: Path) -> None:
    found = every[Verdict.NAMED]
    cause = found.causes[0]
    varies = Varies(cause.effect, "grade", 0.22, (0.49, 0.77), 835.0, (650.0, 1027.0), ("k_t",), "place", 3.0)
    found = replace(found, error_budget={"position": ErrorBudget(0.25, 0.05, 0.001, 0.4, 0.0, 0.299)}, varies=varies)
    write_folder(tmp_path / "found", files_of(found, b""))
    again = load(tmp_path / "found")
    assert (again.varies, again.error_budget) == (found.varies, found.error_budget)
    entry = found.as_dict()
    assert entry["causes"][0]["varies"] == {"spread": 0.22, "over": "place"}
    assert sum(entry["error_budget"]["position"].values()) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("what", "said"),
    [
        (Unexplained("yaw moment", "nothing", "constant", -9, "N m", ""), "constant yaw moment of −9.0 N·m"),
        (
            Unexplained("longitudinal force of rear_left", "own slip", "quadratic", -178e3, "N s^2/m^2", "", 34.2),
            "longitudinal force of rear left that follows own slip (quadratic), 34 N on average",
        ),
        (
            Unexplained("torque of front_left", "wheel angle front_left", "periodic, once a turn", 2.5, "N m", "", 1.7),
            "torque of front left of 2.5 N·m that follows wheel angle front left (periodic, once a turn)",
        ),
    ],
)  # fmt: skip
def test_a_force_is_said_by_what_it_comes_to(what: Unexplained, said: str) -> None:
    assert force_words(what) == said


def test_many_causes_are_a_list(named: Diagnosis) -> None:
    (cause, *_) = named.causes
    others = [replace(cause, effect=name, parameters={}) for name in ("payload", "bulldozing")]
    tied = replace(cause, effect="stribeck", parameters={}, ties=("stiction",))
    many = replace(named, causes=(cause, *others, tied), unexplained=None)
    head = markup(many).split("<h1>")[1].split("<b>Next:</b>")[0]
    assert head.startswith(f"4 causes. {sentences.gain_words(many)}</h1>")
    assert [head.index(f"<li>{said}") for said in ("Slope: grade", "Payload", "Bulldozing")] == sorted(
        head.index(f"<li>{said}") for said in ("Slope: grade", "Payload", "Bulldozing")
    )
    assert (
        "<li>Either stribeck or stiction: these recordings cannot tell which, extended.yaml has stribeck</li>" in head
    )
    few = markup(replace(many, causes=(cause, tied)))
    assert "causes. With" not in few and sentences.headline(replace(many, causes=(cause, tied))) in few


def test_the_page_says_all_that_was_found(every: dict[Verdict, Diagnosis]) -> None:
    for found in every.values():
        text = markup(found)
        assert sentences.headline(found).replace("'", "&#x27;") in text
        for sentence in (*(place.what for place in found.where), *found.warnings, *sentences.branch_words(found)):
            assert sentence.replace("'", "&#x27;") in text
        assert text.index(found.findings[0]) < text.index("<h1>"), "what is wrong with recordings comes first"
        for candidate in found.ranking:
            assert effect_words(candidate.effect) in text
        if found.next_experiment is not None:
            assert found.next_experiment.what in text
        if found.unexplained is not None:
            assert found.unexplained.where in text
        assert not re.search(r'(?:src|href)="(?!#)', text)


def test_many_findings_leave_the_verdict_in_sight(named: Diagnosis) -> None:
    many = tuple(f"run{number}: /imu/data is stamped {number} s late" for number in range(5))
    text = markup(replace(named, findings=many))
    assert all(finding in text for finding in many)
    first, folded, verdict = (
        text.index(many[0]),
        text.index('<details class="findings">'),
        text.index('<p class="verdict'),
    )
    assert first < folded < text.index(many[1]) < text.index(many[-1]) < verdict


def test_names_cannot_break_the_page(named: Diagnosis) -> None:
    nasty = '</script><b>@CHARTS@ & "run"'
    comparisons = tuple(replace(comparison, name=nasty) for comparison in named.comparisons)
    text = markup(replace(named, bags=(nasty,), comparisons=comparisons, warnings=(nasty,)))
    assert "<b>@" not in text
    assert "&lt;b&gt;@CHARTS@" in text


@pytest.mark.parametrize(("verdict", "width"), [*((verdict, 390) for verdict in Verdict), (Verdict.NAMED, 1280)])
def test_a_browser_draws_it_at_any_width(
    chromium: Browser, every: dict[Verdict, Diagnosis], tmp_path: Path, verdict: Verdict, width: int
) -> None:
    page = tmp_path / "report.html"
    page.write_bytes(page_of(every[verdict], "0"))
    chromium.console.clear()
    chromium.requests.clear()
    chromium.size(width, 844, phone=width < 800)
    chromium.open(page, "#all")
    places = chromium.value("document.querySelectorAll('.plot').length")
    chromium.wait(f"document.documentElement.dataset.drawn === '{places}'")
    assert places > 8
    assert not chromium.console
    assert {address.partition("#")[0] for address in chromium.requests} <= {page.as_uri(), "about:blank"}
    assert chromium.value("document.documentElement.scrollWidth") <= width
    sizes = chromium.value(
        "[...document.querySelectorAll('.plot')].map(p => [p.querySelector('svg.main-svg').clientWidth,"
        " p.querySelectorAll('.scatterlayer .trace path, .barlayer path').length])"
    )
    assert all(100 < w <= width and drawn > 0 for w, drawn in sizes)
    models = "[...document.querySelectorAll('.scroll')].filter(t => t.textContent.includes('heading (rad)'))"
    fits = chromium.value(f"{models}.map(t => t.scrollWidth <= t.clientWidth)")
    assert all(fits), "no column of the table of models is out of sight"
    assert fits or not every[verdict].predictors


def test_the_sentence_and_the_picture_are_on_a_phones_first_screen(
    chromium: Browser, named: Diagnosis, tmp_path: Path
) -> None:
    page = tmp_path / "report.html"
    page.write_bytes(page_of(named, "0"))
    chromium.size(390, 844, True)
    chromium.open(page)
    top = chromium.value("document.querySelector('#plot0 svg.main-svg').getBoundingClientRect().top")
    assert top < 0.75 * 844


def test_words_of_the_chart_of_evidence_do_not_overlap(chromium: Browser, named: Diagnosis, tmp_path: Path) -> None:
    """What is needed to be named stands in the legend: on the line it covered the bars' numbers."""
    page = tmp_path / "report.html"
    page.write_bytes(page_of(named, "0"))
    for width in (390, 1280):
        chromium.size(width, 844, phone=width < 800)
        chromium.open(page, "#all")
        boxes = chromium.value(
            "[...document.querySelectorAll('.plot.bars text')].filter(t => t.textContent.trim()).map(t => {"
            "const b = t.getBoundingClientRect(); return [t.textContent, b.left, b.top, b.right, b.bottom]; })"
        )
        assert any("needed to be named" in box[0] for box in boxes) and len(boxes) > 15
        for i, (a, *first) in enumerate(boxes):
            for b, *second in boxes[i + 1 :]:
                apart = first[2] <= second[0] + 2 or second[2] <= first[0] + 2
                apart |= first[3] <= second[1] + 4 or second[3] <= first[1] + 4
                assert apart, (a, b, first, second)


def test_a_recording_without_one_map_shows_three_of_its_windows(named: Diagnosis) -> None:
    """Windows on one origin are a star that nobody can read."""
    run = named.comparisons[-1]
    lost = {**run.covariates, **{name: np.full_like(run.covariates["x"], np.nan) for name in ("x", "y", "heading")}}
    apart = replace(named, comparisons=(replace(run, covariates=lost),))
    drawn = markup(apart).partition("<h2>")[0]
    assert "a typical, a bad and the worst one" in drawn and drawn.count('class="plot square"') == 3
    panels = windows(run)
    assert [panel.key.rpartition("_")[2] for panel in panels] == ["typical", "bad", "worst"]
    for panel in panels:
        for line in panel.lines:
            first = np.flatnonzero(np.isfinite(line.x))[0]
            assert abs(line.x[first]) < 0.2 and abs(line.y[first]) < 0.2  # all begin at the measured start


def test_a_fault_in_a_page_would_be_seen(chromium: Browser, tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    page.write_text(
        "<!DOCTYPE html><img src='http://example.org/x.png'><script>document.documentElement.dataset.drawn = '0';"
        "nowhere.to.be.found()</script><p style='width: 2000px'>x</p>",
        encoding="utf-8",
    )
    chromium.console.clear()
    chromium.requests.clear()
    chromium.size(390, 844, True)
    chromium.open(page)
    assert any("nowhere is not defined" in line for line in chromium.console)
    assert "http://example.org/x.png" in chromium.requests
    assert chromium.value("document.documentElement.scrollWidth") > 390


def with_law(found: Diagnosis) -> Diagnosis:
    """A diagnosis of something on no list that was fitted as a law."""
    law = EFFECTS["force_law"].read(
        {"size": 14.0, "where": "wheels_lateral", "variable": "place", "form": "periodic", "scale": 1.1}, "law"
    )
    parameters = {name: EffectEstimate(value) for name, value in law.items()}
    parameters |= {"size": EffectEstimate(14.0, "SI", (13.0, 15.0)), "phase": EffectEstimate(0.4, "rad", (0.3, 0.5))}
    what = replace(
        found.unexplained, laws={"force_law": parameters}, log10_bayes_factor=120.0, spans={"force_law": (0.0, 2.2)},
        residuals={"force_law": ((0.2, 0.5, 0.4), (0.9, -1.5, 0.6))},
    )  # fmt: skip
    return replace(found, unexplained=what, extended=replace(found.robot, effects={"force_law": law}))


def test_a_law_stands_on_the_page_as_a_formula_and_a_curve_with_what_it_gains(every: dict[Verdict, Diagnosis]) -> None:
    plain, found = every[Verdict.UNEXPLAINED], with_law(every[Verdict.UNEXPLAINED])
    said = markup(found)
    formula = "lateral force of each wheel = 14 N · cos(2π place along 0° in map / 1.1 m + 0.40)"
    formula += " (size 13 to 15 N, phase 0.3 to 0.5 rad)"
    assert formula in said and formula not in markup(plain)
    assert "What it gains" in said and "What it gains" not in markup(plain)
    assert "With it as a law of the model, predictions" in sentences.headline(found)
    assert "With it" not in sentences.headline(plain)
    curve = law_curve(found.unexplained, "force_law")
    assert curve is not None
    bars, asked, line = curve.lines
    np.testing.assert_allclose(asked.y, 14.0 * np.cos(2.0 * np.pi * asked.x / 1.1 + 0.4) + [0.5, -1.5], atol=1e-9)
    np.testing.assert_allclose(bars.y[1::3] - bars.y[::3], 2.0 * 1.96 * np.array([0.4, 0.6]), atol=1e-9)
    np.testing.assert_allclose(line.y, 14.0 * np.cos(2.0 * np.pi * line.x / 1.1 + 0.4), atol=1e-9)
    assert line.x[0] == 0.0 and line.x[-1] == 2.2


def test_files_give_the_diagnosis_back(every: dict[Verdict, Diagnosis], tmp_path: Path) -> None:
    for verdict, found in [*every.items(), (Verdict.UNEXPLAINED, with_law(every[Verdict.UNEXPLAINED]))]:
        folder = tmp_path / f"{verdict.value}{found.extends}"
        found = replace(found, holdout_likelier=(3.0, 9.5)) if found.extends else found
        write_folder(folder, files_of(found, b"page"))
        again = load(folder)
        assert again.as_dict() == found.as_dict()
        assert page_of(again, "0") == page_of(found, "0")
        for mine, its in zip(found.comparisons, again.comparisons, strict=True):
            assert np.array_equal(mine.path, its.path)
            assert np.array_equal(mine.channels["position"].after, its.channels["position"].after, equal_nan=True)
        extended = load_robot(folder / "extended.yaml")
        assert dict(extended.effects) == dict(found.extended.effects)
        assert files_of(found, b"page") == files_of(found, b"page")


def test_what_is_not_finite_survives(named: Diagnosis, tmp_path: Path) -> None:
    """JSON has no infinity; the contract's schema has null for it."""
    channel = ChannelBaseline("m", 0.1, 0.01, float("nan"))
    write_folder(tmp_path / "x", files_of(replace(named, baseline={"position": channel}), b""))
    document = json.loads((tmp_path / "x" / "diagnosis.json").read_text())
    assert document["baseline"]["position"]["free_run_rmse"] is None
    assert np.isnan(load(tmp_path / "x").baseline["position"].free_run_rmse)


@pytest.mark.parametrize("broken", ["diagnosis.json", "details.npz", "extended.yaml"])
def test_a_broken_result_is_one_clear_line(named: Diagnosis, tmp_path: Path, broken: str) -> None:
    write_folder(tmp_path / "x", files_of(named, b""))
    whole = (tmp_path / "x" / broken).read_bytes()
    for content in (b"", whole[: len(whole) // 2], None):
        if content is None:
            (tmp_path / "x" / broken).unlink()
        else:
            (tmp_path / "x" / broken).write_bytes(content)
        with pytest.raises(ArtibotError, match=r"x"):
            load(tmp_path / "x")


def test_a_folder_is_written_whole_or_not_at_all(tmp_path: Path) -> None:
    with pytest.raises(ArtibotError, match="cannot be"):
        write_folder(tmp_path / "new", {"a": b"1", "no/such/folder/b": b"2"})
    assert list(tmp_path.iterdir()) == []
    write_folder(tmp_path / "deep" / "new", {"a": b"1"})
    (tmp_path / "deep" / "new" / "mine").write_text("kept")
    with pytest.raises(ArtibotError, match="cannot be"):
        write_folder(tmp_path / "deep" / "new", {"a": b"3", "no/such/folder/b": b"2"})
    assert {path.name: path.read_text() for path in (tmp_path / "deep" / "new").iterdir()} == {"a": "1", "mine": "kept"}


def test_report_draws_a_diagnosis_again(named: Diagnosis, tmp_path: Path) -> None:
    write_folder(tmp_path / "found", files_of(named, b"old"))
    assert main(["report", str(tmp_path / "found")]) == 0
    assert sentences.headline(named).encode() in (tmp_path / "found" / "report.html").read_bytes()
    other = tmp_path / "other.html"
    assert main(["report", str(tmp_path / "found" / "diagnosis.json"), "--html", str(other)]) == 0
    assert other.read_bytes() == (tmp_path / "found" / "report.html").read_bytes()


def test_its_one_line_has_the_verdict_the_causes_and_the_recordings(every: dict[Verdict, Diagnosis]) -> None:
    for verdict, found in every.items():
        line = str(found)
        assert "\n" not in line and line.startswith(verdict.value)
        assert all(word in line for word in (*(cause.effect for cause in found.causes), *found.bags, *found.holdout))


def test_it_prints(every: dict[Verdict, Diagnosis]) -> None:
    for found in every.values():
        text = " ".join(as_text(found).split())
        assert sentences.headline(found) in text
        assert text.startswith(found.findings[0])
        assert all(f"warning: {warning}" in text for warning in found.warnings)
        assert all(channel_words(name) in text for name in found.gain)


def test_a_measured_path_is_not_joined_across_a_gap(named: Diagnosis) -> None:
    comparison = named.comparisons[0]
    shifted = comparison.path + np.where(np.arange(len(comparison.path)) >= 60, 3.0, 0.0)[:, None] * (1.0, 0.0, 0.0)
    line = path(replace(comparison, path=shifted), "path").lines[0]
    assert np.isnan(line.x[60]) and np.isfinite(line.x[61])
    assert np.isnan(line.x).sum() == 2  # the gap, and the end
