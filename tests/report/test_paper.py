"""The paper's numbers: checks of the transcription."""

from __future__ import annotations

import pytest

from report.paper import read_paper

PAPER = read_paper()
DIGITS = {"psnr": 2, "ssim": 3, "lpips": 3, "storage_mb": 2}


def test_some_of_them():
    assert PAPER.quality("veach_ajar", "path_10") == {"psnr": 9.276, "ssim": 0.098, "lpips": 0.651}
    assert PAPER.quality("veach_ajar", "sppm_3")["storage_mb"] == 405.3
    assert PAPER.quality("water_caustic_2", "anysplat_10")["lpips"] == 0.235
    assert PAPER.quality("water_caustic", "instant_ngp_3")["psnr"] == 13.42
    assert PAPER.quality("cornell_box", "splatting_3") == {}
    assert (
        PAPER.time("veach_ajar", "second_reference") == 14010
        and PAPER.time("veach_bidir", "gpf") == 6.3
    )
    assert PAPER.time("veach_bidir", "em_gmm") is None
    assert [v.lpips for v in PAPER.ablations.of("k")] == [0.2314, 0.1579, 0.1574, 0.1595]
    assert [v.seconds_per_view for v in PAPER.ablations.gaussians] == [7.23, 12.7, 16.37, 24.35]
    assert PAPER.ablations.of("switches") == ()


@pytest.mark.parametrize("method", list(PAPER.mean))
def test_printed_means_are_those_of_the_scenes(method):
    """A wrong digit in a scene changes its mean by more than rounding, half a digit."""
    scenes = list(PAPER.systems)
    assert len(scenes) == 5
    for key, printed in PAPER.mean[method].known.items():
        exact = sum(PAPER.quality(scene, method)[key] for scene in scenes) / 5
        assert abs(exact - printed) <= 0.51 * 10 ** -DIGITS[key], (key, exact)
    assert PAPER.mean_over(scenes, method) == PAPER.mean[method].known


def test_means_over_fewer_scenes():
    mean = PAPER.mean_over(["cornell_box", "water_caustic"], "gpf")
    assert mean["psnr"] == pytest.approx((39.73 + 27.12) / 2)
    assert PAPER.mean_over(["cornell_box", "water_caustic"], "splatting_3") == {}


def test_the_same_field_has_the_same_numbers_everywhere():
    """Its rows in Tables 3, S1 and S2 agree with the rounded ones of Water-Caustic in Table 1."""
    known = PAPER.quality(PAPER.ablations.scene, "gpf")
    for group, title in (("components", "all"), ("gaussians", "100,000"), ("k", "3")):
        row = next(v for v in PAPER.ablations.of(group) if v.title == title)
        assert row.psnr == known["psnr"]
        assert (row.ssim, row.lpips) == pytest.approx((known["ssim"], known["lpips"]), abs=5.1e-4)


def test_every_method_is_found_by_its_settings():
    tables = [*PAPER.systems.values(), *PAPER.learned.values(), PAPER.mean, PAPER.seconds]
    assert {method for table in tables for method in table} == set(PAPER.methods)
    assert PAPER.name_of({"system": "path_tracer", "spp": 10, "scenes": []}) == "path_10"
    assert PAPER.name_of({"system": "path_tracer", "spp": 11}) == ""
    assert PAPER.name_of({"system": "second_reference", "passes": 1000}) == "second_reference"
