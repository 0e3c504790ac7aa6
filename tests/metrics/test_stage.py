"""Stage `metrics`: methods that were not run, and references that are missing."""

from __future__ import annotations

import numpy as np
import pytest

from gpf.core.errors import UserError
from gpf.core.files import read_json, write_json, write_text
from gpf.core.images import read_exr, write_exr
from metrics.image import compare, flip_exposures
from stages import metrics
from stages.common.makers import naming_commands
from stages.common.workspace import Workspace
from stages.config.params import Params

SCENE, VIEWS = "cornell_box", ("above", "below")
METHODS = {"path_10": {"system": "path_tracer", "spp": 10}, "em_gmm": {"system": "em_gmm"}}
PARAMS = {
    "scenes": [SCENE],
    "reference": {"passes": 4},
    "methods": {"classical": list(METHODS)},
    "baselines": METHODS,
    "metrics": {"relmse_epsilon": 0.03},
}
run = naming_commands()(metrics.run)  # as the command line calls it

VIEWS_FILE = """\
exposure: 0.3
aspect: 1.5
views:
  train: [{name: front, origin: [0, 0, 4], target: [0, 0, 0], fov: 40}]
  novel:
    - {name: above, origin: [0, 2, 4], target: [0, 0, 0], fov: 40}
    - {name: below, origin: [0, -2, 4], target: [0, 0, 0], fov: 40}
"""


@pytest.fixture
def work(tmp_path, monkeypatch):
    """A scene with references and with images of the field and of one row of `methods`."""
    work = Workspace(Params.model_validate(PARAMS), SCENE, tmp_path / "results")
    monkeypatch.setattr(Workspace, "open", classmethod(lambda cls, scene: work))
    write_text(work.views_file, VIEWS_FILE)
    image = np.random.default_rng(4).uniform(0.1, 0.9, (8, 12, 3)).astype(np.float32)
    for view, light in zip(VIEWS, (1, 30), strict=True):
        record = {"view": work.views.find(view).model_dump(mode="json"), "passes": 4}
        layers = {"sppm_1": 0.5 * light * image, "sppm_4": 0.9 * light * image}
        write_exr(work.reference(view), {"radiance": light * image}, record)
        write_exr(work.second_reference(view), layers, record)
        for method in ("gpf", "path_10"):
            write_exr(work.render(method, view), {"radiance": 0.8 * light * image}, record)
    return work


def test_images_are_compared_at_the_exposure_of_the_scene_and_in_the_range_of_all_references(work):
    run(SCENE)
    references = [read_exr(work.reference(view))[0]["radiance"] for view in VIEWS]
    first, last = flip_exposures(references)
    assert (first, last) != flip_exposures(references[:1])
    for view, reference in zip(VIEWS, references, strict=True):
        wanted = compare(0.8 * reference, reference, 0.3, first, last, 0.03)
        found = read_json(work.metrics("gpf"))["views"][view]
        for name in ("psnr", "ssim", "flip", "flip_hdr", "relmse"):
            assert found[name] == pytest.approx(wanted[name], rel=1e-3), name


def test_a_method_that_was_not_run_is_left_out(work, capsys):
    write_json(work.metrics("em_gmm"), {"mean": {"psnr": 99.0}})  # of images that no longer exist
    run(SCENE)
    assert set(read_json(work.summary)) == {"gpf", "path_10", "second_reference"}
    assert not work.metrics("em_gmm").exists()
    said = " ".join(capsys.readouterr().err.split())
    assert "em_gmm has no images" in said and "path_10 has no images" not in said
    assert f"`gpf stage baseline --method em_gmm --scene {SCENE}`" in said


def test_a_method_that_cannot_serve_the_scene_keeps_its_reason(work, capsys):
    write_json(work.refusal("em_gmm"), {"reason": "no photons"})
    run(SCENE)
    assert read_json(work.metrics("em_gmm")) == {"cannot_serve": "no photons"}
    assert "left out" not in capsys.readouterr().err


def test_images_of_some_views_alone_are_an_error(work):
    work.render("path_10", "below").unlink()
    with pytest.raises(UserError, match=r"below\.exr: is missing.*baseline --method path_10"):
        run(SCENE)
    assert not work.summary.exists()


@pytest.mark.parametrize("kind", ["reference", "second_reference"])
def test_a_missing_reference_is_an_error(work, kind):
    getattr(work, kind)("below").unlink()
    with pytest.raises(UserError, match=r"below\.exr: is missing.*`gpf stage reference --scene"):
        run(SCENE)
    assert not work.summary.exists()


def test_the_field_is_left_out_if_it_has_no_images(work, capsys):
    for view in VIEWS:
        work.render("gpf", view).unlink()
    run(SCENE)
    assert set(read_json(work.summary)) == {"path_10", "second_reference"}
    assert f"`gpf stage render --scene {SCENE}`" in " ".join(capsys.readouterr().err.split())


def test_the_second_reference_is_left_out_if_it_has_no_images(work, capsys):
    run(SCENE)
    assert len(read_json(work.convergence)) == 2
    for view in VIEWS:
        work.second_reference(view).unlink()
    run(SCENE)
    assert set(read_json(work.summary)) == {"gpf", "path_10"}
    assert read_json(work.metrics("gpf"))["mean"]["psnr"] > 10
    assert read_json(work.convergence) == []
    assert f"`gpf stage reference --scene {SCENE}`" in " ".join(capsys.readouterr().err.split())
