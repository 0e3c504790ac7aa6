"""The way to AnySplat and back, with a stand-in for its network that answers with known Gaussians,
in a frame that is a known similarity away."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from baselines.anysplat.baseline import CODE, Anysplat, make_picture
from baselines.anysplat.predicted_splats import Prediction, draw, make_splats
from baselines.anysplat.sim3 import Similarity
from baselines.options import AnySplatOptions
from baselines.protocol import CannotServe, TrainingView
from gpf.core.images import tone_map, undo_tone_map
from gpf.scene.pinhole import make_pinhole
from gpf.scene.views import View
from tests.baselines.adapters import STAND_INS, make_task, write_weights

SIZE = (12, 8)
BACKGROUND = np.array([1.0, 0.5, 0.25])
ELSEWHERE = Similarity(
    0.4, Rotation.from_euler("xyz", [25, -70, 160], degrees=True).as_matrix(), np.array([3, -1, 2])
)
NOVEL = View(name="n", origin=(0.5, -4, 1.4), target=(0, 0, 0.1), up=(0, 0, 1), fov=40)


def training_views() -> list[TrainingView]:
    """Three views; the upper left corners of their pictures are 0, 0.1 and 0.2 bright."""
    shots = []
    for k, (x, y) in enumerate([(2.5, -3), (-2.0, -3.5), (0.3, -4.4)]):
        view = View(
            name=f"t{k}", origin=(x, y, 1 + 0.3 * k), target=(0, 0, 0), up=(0, 0, 1), fov=40
        )
        radiance = np.full((SIZE[1], SIZE[0], 3), 1.5, dtype=np.float32)
        radiance[:, : SIZE[0] // 2] = undo_tone_map(np.array(k / 10)) / 0.5
        shots.append(TrainingView(view, {"radiance": radiance}))
    return shots


def gaussians_in_the_world() -> Prediction:
    """Some that are long, coloured, and of another colour from another side."""
    rng = np.random.default_rng(2)
    count = 60
    rotation = Rotation.random(count, random_state=1).as_matrix()
    extents = np.exp(rng.uniform(np.log(0.05), np.log(0.5), (count, 3)))
    cameras = [make_pinhole(shot.view, SIZE) for shot in training_views()]
    intrinsics = np.tile(np.eye(3), (3, 1, 1))
    intrinsics[:, 0, 0] = intrinsics[:, 1, 1] = cameras[0].focal / min(SIZE)
    return Prediction(
        means=rng.uniform(-1, 1, (count, 3)),
        covariances=np.einsum("nij,nj,nkj->nik", rotation, extents**2, rotation),
        harmonics=rng.normal(0, 0.6, (count, 3, 4)),
        opacities=rng.uniform(0.1, 0.95, count),
        poses=np.stack([camera.pose for camera in cameras]),
        intrinsics=intrinsics,
        background=BACKGROUND,
        seconds=1.5,
        device="cpu",
    )


def as_seen_elsewhere(world: Prediction) -> Prediction:
    """The same in the network's frame: what the network would answer."""
    rotation, poses = ELSEWHERE.rotation, world.poses.copy()
    poses[:, :3, :3] = rotation @ poses[:, :3, :3]
    poses[:, :3, 3] = ELSEWHERE.apply(poses[:, :3, 3])
    # The linear harmonics are a vector, of which 3DGS stores -y, z, -x.
    order, sign = [3, 1, 2], np.array([-1, -1, 1])
    vectors = (world.harmonics[:, :, order] * sign) @ rotation.T
    harmonics = world.harmonics.copy()
    harmonics[:, :, order] = vectors * sign
    return replace(
        world,
        means=ELSEWHERE.apply(world.means),
        covariances=ELSEWHERE.scale**2 * rotation @ world.covariances @ rotation.T,
        harmonics=harmonics,
        poses=poses,
    )


def arrays_of(found: Prediction) -> dict[str, Any]:
    return {name: np.asarray(value) for name, value in vars(found).items()}


def prepare(state: Path, weights: str = "nothing") -> Any:
    options = AnySplatOptions(system="anysplat", weights=weights, views=3)
    return Anysplat(options).prepare(make_task(state, None, SIZE, tuple(training_views())))


def prepare_from(state: Path, found: Prediction) -> Any:
    """As after a preparation that was killed once the network had answered."""
    np.savez(state / "splats.npz", **arrays_of(found))
    return prepare(state)


def test_what_comes_back_is_seen_from_the_true_cameras(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    world = gaussians_in_the_world()
    answer = arrays_of(as_seen_elsewhere(world))
    names = ("means", "covariances", "harmonics", "opacities")
    tensors = {f"answer.{name}": answer[name] for name in names}
    tensors |= {"answer.extrinsic": answer["poses"], "answer.intrinsic": answer["intrinsics"]}
    monkeypatch.setenv(CODE.variable, str(STAND_INS / "anysplat"))
    prepared = prepare(tmp_path, write_weights(tmp_path / "weights", tensors))
    image = prepared.render(NOVEL, 1)

    shown = draw(make_splats(world), make_pinhole(NOVEL, SIZE), BACKGROUND)
    expected = undo_tone_map(shown) / 0.5
    assert image.shape == (8, 12, 3) and image.dtype == np.float32
    assert expected.std() > 0.2 and np.abs(expected - expected[:, ::-1]).max() > 0.2
    np.testing.assert_allclose(image, expected, atol=2e-3)
    facts = prepared.facts
    assert facts["gaussians"] == 60 and facts["device"] in ("cpu", "cuda")
    assert facts["camera_error"] < 1e-5 and facts["focal_ratio"] == pytest.approx(1, abs=1e-5)
    assert prepared.storage_bytes == 60 * 4 * (3 + 3 + 4 + 1 + 12)

    # A call that comes after needs neither the code nor the weights.
    monkeypatch.delenv(CODE.variable)
    np.testing.assert_array_equal(prepare(tmp_path).render(NOVEL, 2), image)


def test_a_network_that_takes_pictures_for_wider_is_given_wider_views(tmp_path: Path) -> None:
    world = gaussians_in_the_world()
    wider = world.intrinsics.copy()
    wider[:, 0, 0] *= 0.8
    wider[:, 1, 1] *= 0.8
    prepared = prepare_from(tmp_path, as_seen_elsewhere(replace(world, intrinsics=wider)))
    assert prepared.facts["focal_ratio"] == pytest.approx(0.8)
    camera = make_pinhole(NOVEL, SIZE)
    shown = draw(make_splats(world), replace(camera, focal=0.8 * camera.focal), BACKGROUND)
    np.testing.assert_allclose(prepared.render(NOVEL, 1), undo_tone_map(shown) / 0.5, atol=2e-3)


def test_how_far_its_cameras_are_off_is_told(tmp_path: Path) -> None:
    found = as_seen_elsewhere(gaussians_in_the_world())
    found.poses[1, :3, 3] += 0.3
    assert 0.02 < prepare_from(tmp_path, found).facts["camera_error"] < 0.5


def test_an_opaque_gaussian_hides_the_background_and_a_far_one_does_not() -> None:
    harmonics = np.zeros((1, 3, 4))
    harmonics[0, :, 0] = [1, 0, -1]
    harmonics[0, :, 1] = [0, 0, 1]  # of -y, and the camera looks along y
    single = replace(
        gaussians_in_the_world(),
        means=np.zeros((1, 3)),
        covariances=np.diag([9, 1e-3, 1e-2])[None],
        harmonics=harmonics,
        opacities=np.ones(1),
    )
    level = NOVEL.model_copy(update={"origin": (0, -4, 0), "target": (0, 0, 0)})
    camera = make_pinhole(level, (13, 9))
    image = draw(make_splats(single), camera, BACKGROUND)
    colour = [0.5 + 0.28209, 0.5, 0.5 - 0.28209 - 0.48860 * 1]
    np.testing.assert_allclose(image[4, 6], np.maximum(colour, 0), atol=2e-3)
    np.testing.assert_allclose(image[4, 2], image[4, 6], atol=0.1)  # it is wide,
    np.testing.assert_allclose(image[1, 6], BACKGROUND, atol=2e-3)  # but not high
    away = replace(single, means=np.full((1, 3), 50.0), covariances=np.eye(3)[None] * 1e-4)
    np.testing.assert_allclose(
        draw(make_splats(away), camera, BACKGROUND), np.tile(BACKGROUND, (9, 13, 1)), atol=1e-6
    )


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"means": np.zeros((59, 3))}, r"covariances: \(60, 3, 3\), where \(59, 3, 3\)"),
        ({"poses": np.tile(np.eye(4), (2, 1, 1))}, r"poses: \(2, 4, 4\), where \(3, 4, 4\)"),
        ({"opacities": np.full(60, np.nan)}, "opacities has NaN or infinite"),
        ({"poses": np.tile(np.eye(4), (3, 1, 1))}, "cannot be aligned.*all are in one place"),
        (
            {
                "means": np.zeros((0, 3)),
                "covariances": np.zeros((0, 3, 3)),
                "harmonics": np.zeros((0, 3, 1)),
                "opacities": np.zeros(0),
            },
            "has no Gaussians",
        ),
    ],
)
def test_answers_that_cannot_be_used_are_refused(
    tmp_path: Path, change: dict[str, np.ndarray], words: str
) -> None:
    with pytest.raises(CannotServe, match=words):
        prepare_from(tmp_path, replace(gaussians_in_the_world(), **change))


def test_a_damaged_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "splats.npz").write_bytes(b"PK\x03\x04 and no more")
    with pytest.raises(CannotServe, match="is not a file of arrays.*Delete"):
        prepare(tmp_path)


def test_what_is_missing_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(CODE.variable, raising=False)
    with pytest.raises(CannotServe, match="package not installed.*git clone.*AnySplat.*GPF_ANYSPL"):
        prepare(tmp_path)
    monkeypatch.setenv(CODE.variable, str(STAND_INS / "anysplat"))
    with pytest.raises(CannotServe, match="weights not installed: nobody/nothing.*hf download"):
        prepare(tmp_path, "nobody/nothing")
    folder = tmp_path / "no_weights"
    folder.mkdir()
    with pytest.raises(CannotServe, match="weights not installed: .*no_weights has no config.json"):
        prepare(tmp_path, str(folder))


def test_pictures_are_the_middle_squares_as_shown() -> None:
    rows, columns = np.mgrid[:48, :64]
    ramp = np.stack([columns / 64, rows / 48, 0 * rows], axis=2).astype(np.float32)
    shot = TrainingView(NOVEL, {"radiance": ramp})
    picture = make_picture(shot, 0.5)
    assert picture.shape == (448, 448, 3) and picture.dtype == np.uint8
    expected = tone_map(np.array([32 / 64, 24 / 48, 0]), 0.5) * 255
    np.testing.assert_allclose(picture[224, 224], expected, atol=2)
    # 8 columns are cut off on either side.
    np.testing.assert_allclose(picture[224, 2, 0], tone_map(np.array(8 / 64), 0.5) * 255, atol=3)
    np.testing.assert_allclose(picture[2, 224, 1], 0, atol=3)
    np.testing.assert_allclose(undo_tone_map(tone_map(np.array([0.001, 0.3]), 1)), [0.001, 0.3])


def test_the_arrays_are_those_that_are_drawn() -> None:
    splats = make_splats(gaussians_in_the_world())
    assert len(splats.means) == 180 and isinstance(splats.means, mi.Float)
    many = replace(gaussians_in_the_world(), harmonics=np.ones((60, 3, 25)))
    assert len(make_splats(many).harmonics) == 60 * 3 * 15
