"""Values that a pipeline leaves open are chosen once, from the error of the answer, and stay as they are."""

import json
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

from etendue.accuracy.discretising import Refinement
from etendue.accuracy.holding import Asked, hold
from etendue.cli.program import main
from etendue.contract.registry import installed_stages
from etendue.errors import RequestError
from etendue.pipeline.toml import dumps
from etendue.plan.planner import make_plan
from etendue.plan.wiring.automatic import left_open, settled, with_chosen
from etendue.session import Options, execute, load

OPEN = {"bin_width": "auto", "spacing": "auto", "surround": "auto"}


def document(use="slanted_edge", sweep=None, **scene):
    stage = {
        "use": use,
        "name": "scene",
        "white_luminance": 1000,
        "width": 48,
        "height": 40,
        "wavelength_from": 400,
        "wavelength_to": 700,
        **{**OPEN, **scene},
    }
    stages = [stage, *({"use": use} for use in ("irradiance", "diffraction", "lens_gaussian"))]
    stages += [{"use": "pixel", "rows": 8, "columns": 10}, {"use": "mosaic"}]
    camera = {"pixel_pitch": "4 um", "f_number": 4, "peak_qe": [0.36, 0.44, 0.4]}
    found = {"name": "left_open", "camera": camera, "stages": stages, "wanted": ["photon_rate"]}
    return found | ({"sweep": sweep} if sweep else {})


def values(made):
    scene = make_plan(load(made), installed_stages()).of("scene")[0].stage
    return {name: getattr(scene, name) for name in OPEN}


def test_what_is_left_open_has_the_value_of_its_rule_in_every_plan():
    assert values(document()) == pytest.approx({"bin_width": 10, "spacing": 2, "surround": 6})
    swept = document(sweep={"pixel_pitch": ["3 um", "4 um", "1.9 um"]})
    found = values(swept)
    assert 48 / found["spacing"] == pytest.approx(round(48 / found["spacing"]))
    assert 0.85 < found["spacing"] <= 0.95
    assert values(document(wavelength_to=705))["bin_width"] == pytest.approx(305 / 31)
    assert values(document("colorchecker"))["surround"] == 0


def test_a_plan_of_what_is_left_open_has_the_keys_of_the_numbers_written():
    found = values(document())
    own, written = (make_plan(load(made), installed_stages()) for made in (document(), document(**found)))
    assert [cell.key for cell in own.cells.values()] == [cell.key for cell in written.cells.values()]
    assert any("scene.spacing" in text and "automatically" in text for text in own.warnings)
    assert settled(load(document(**found)), installed_stages()) == (load(document(**found)), [])


def test_the_schema_of_a_file_knows_what_may_be_left_open():
    stages = json.loads(CliRunner().invoke(main, ["schema"]).stdout)
    text = json.dumps(stages)
    assert text.count('{"const": "auto"}') >= len(OPEN)


@pytest.mark.parametrize("name", ["width", "white_luminance"])
def test_what_no_rule_chooses_is_refused(name):
    with pytest.raises(RequestError, match="expected a number"):
        make_plan(load(document(**{name: "auto"})), installed_stages())


def test_a_surround_moves_no_sample_and_is_refused_where_the_chart_fills_the_scene():
    registry = installed_stages()
    narrow, wide = (
        make_plan(load(document(spacing=2, surround=s)), registry).of("scene")[0].grids["radiance"] for s in (0, 12)
    )
    for dim in ("y", "x"):
        one, other = (grid.line(dim).values() for grid in (narrow, wide))
        assert np.allclose(one, other[6:-6])
    with pytest.raises(RequestError, match="fills its width"):
        make_plan(load(document("colorchecker", surround=5)), registry)


@pytest.mark.parametrize("limit", [0.03, 6e-3])
def test_the_error_of_the_answer_is_within_what_is_held(limit):
    """Refined once more, all discretisations together, the picture changes by no more than what is held."""
    registry = installed_stages()
    pipeline = load(document())
    found = hold(pipeline, registry, limit)
    assert found.held
    assert found.chosen.spent["photon_rate"] <= limit
    chosen = replace(with_chosen(pipeline, found.chosen.values), tolerance=found.tolerance)
    plan = make_plan(chosen, registry)
    scene = found.chosen.values["scene"]
    finer = {"spacing": scene["spacing"] / 3, "bin_width": 5, "surround": 48}
    exact = make_plan(load(document(**finer) | {"precision": "float64", "leave_out": False}), registry, False)
    own, truth = (execute(one, None, Options("serial", pictures=False)).arrays["pixel", ()] for one in (plan, exact))
    full = truth["photon_rate"].max()
    assert np.sqrt(np.mean((own["photon_rate"] - truth["photon_rate"]) ** 2)) <= limit * full


def test_a_stricter_goal_refines_and_written_numbers_stay():
    registry = installed_stages()
    loose, strict = (hold(load(document()), registry, limit) for limit in (0.2, 0.01))
    assert loose.chosen.refined == ()
    assert "scene.spacing" in strict.chosen.refined
    partly = hold(load(document(bin_width=100)), registry, 0.03)
    assert "bin_width" not in partly.chosen.values["scene"]
    assert hold(load(document(**values(document()))), registry, 0.03).chosen is None
    too_coarse = hold(load(document(bin_width=100)), registry, 1e-4).chosen
    assert too_coarse.refined == ()
    assert too_coarse.missed["photon_rate"].startswith("bins alone")
    assert "the file does not leave it open" in too_coarse.missed["photon_rate"]


def test_what_memory_or_time_do_not_allow_is_said_with_what_it_would_need(monkeypatch):
    registry, asked = installed_stages(), Asked(1e-6)
    pipeline, _ = settled(load(document()), registry)
    open_ = left_open(load(document()), registry)
    short = Refinement(pipeline, registry, open_, asked, 1.0).found()
    assert short.missed
    assert "s" in short.needed
    monkeypatch.setattr("etendue.accuracy.discretising.available_memory", lambda: 10_000_000)
    small = Refinement(pipeline, registry, open_, Asked(1e-4), 30.0).found()
    assert small.missed
    assert "of memory" in small.needed
    none = Refinement(pipeline, registry, open_, asked, 0.0).found()
    assert none.missed["photon_rate"]
    assert none.refined == ()


def run(file, archive, *words):
    done = CliRunner().invoke(main, ["run", str(file), "--archive", str(archive), "--scheduler", "serial", *words])
    assert done.exit_code == 0, done.output
    return done


def test_an_archive_keeps_what_its_first_run_has_chosen(tmp_path, monkeypatch):
    """A resumed run computes nothing; a grown axis that would have finer samples gets a note; ``rerun`` and
    ``reproduce`` need no rule."""
    monkeypatch.setenv("ETENDUE_CACHE", str(tmp_path / "cache"))
    file, archive = tmp_path / "file.toml", tmp_path / "a"
    file.write_text(dumps(document(sweep={"pixel_pitch": ["4 um"]})))
    first = json.loads(run(file, archive, "--hold", "0.01", "--json").stdout)
    kept = first["hold"]["discretisation"]
    assert first["hold"]["held"]
    assert not kept["kept"]
    assert first["answer"]["errors"]["photon_rate"]["rms"] <= 0.01
    again = json.loads(run(file, archive, "--hold", "0.01", "--json").stdout)
    assert again["computed"] == 0
    assert again["hold"]["discretisation"]["kept"]
    assert again["hold"]["discretisation"]["values"] == kept["values"]
    plain = json.loads(run(file, archive, "--json").stdout)
    assert plain["computed"] <= 6  # the tolerance of the file is another one; the scene is the same
    grown = run(file, archive, "--sweep", "pixel_pitch=0.5 um,4 um")
    assert "as chosen by an earlier run into this archive" in " ".join(grown.stderr.split())
    for command in (
        ["rerun", str(archive), "--scheduler", "serial"],
        ["reproduce", str(archive)],
        ["verify", str(archive)],
    ):
        done = CliRunner().invoke(main, command)
        assert done.exit_code == 0, done.output


def test_a_grown_axis_that_needs_finer_is_told_so_and_nothing_is_refined(tmp_path, monkeypatch):
    monkeypatch.setenv("ETENDUE_CACHE", str(tmp_path / "cache"))
    file, archive = tmp_path / "file.toml", tmp_path / "a"
    file.write_text(dumps(document(sweep={"f_number": [16], "lens_gaussian.sigma": [6]})))
    words = ("--hold", "0.03", "--json")
    first = json.loads(run(file, archive, *words).stdout)
    grown = run(file, archive, *words, "--sweep", "f_number=1,16", "--sweep", "lens_gaussian.sigma=0.05,6")
    hold_ = json.loads(grown.stdout)["hold"]
    assert hold_["discretisation"]["values"] == first["hold"]["discretisation"]["values"]
    assert hold_["discretisation"]["kept"]
    assert "too coarse here" in grown.stderr
    assert not hold_["held"]
