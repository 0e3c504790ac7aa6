"""The radiance cache on a sheet whose irradiance is known, and other on its two sides."""

from collections.abc import Callable
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest

from baselines.neural import fitting
from baselines.neural.hash_encoding import GridShape
from baselines.options import RadianceCacheOptions
from baselines.protocol import SharedField, Task
from baselines.radiance_cache import baseline
from baselines.radiance_cache.baseline import PreparedCache, RadianceCache
from baselines.radiance_cache.cached_irradiance import CacheShape
from gpf.scene.pinhole import make_pinhole
from gpf.scene.views import View
from gpf.training.targets import Targets
from stages.references.targets import save

WIDTH, HEIGHT = 8, 6
STEPS = 500
ABOVE = View(name="above", origin=(0.3, -0.6, 2.5), target=(0.1, 0, 0), up=(0, 1, 0), fov=40)
BELOW = ABOVE.model_copy(update={"name": "below", "origin": (0.3, -0.6, -2.5)})
REFLECTANCE = np.array([0.2, 0.5, 0.8])


def irradiance_at(x: np.ndarray, side: float) -> np.ndarray:
    """Five times darker, and of another colour, below."""
    a, b = x[:, 0], x[:, 1]
    above = np.column_stack([2 + np.sin(3 * a), 1 + b**2, 3 - 0.5 * a * b])
    return above if side > 0 else 0.2 * above[:, ::-1]


def make_targets(count: int) -> Targets:
    rng = np.random.default_rng(1)
    x = np.column_stack([rng.uniform(-1.5, 1.5, (count, 2)), np.zeros(count)])
    side = np.where(rng.random(count) < 0.5, 1.0, -1.0)
    expected = np.where(side[:, None] > 0, irradiance_at(x, 1), irradiance_at(x, -1))
    rows = [x, side[:, None] * [0, 0, 1], expected, np.zeros_like(x), np.ones_like(x)]
    source = np.where(rng.random(count) < 0.5, -1, 0).astype(np.int32)
    return Targets(*(row.astype(np.float32) for row in rows), source)


@pytest.fixture
def task(tmp_path: Path) -> Task:
    scene = mi.load_dict(
        {
            "type": "scene",
            "sheet": {
                "type": "rectangle",
                "to_world": mi.ScalarTransform4f().scale([1.5, 1.5, 1]),
                "bsdf": {
                    "type": "twosided",
                    "inside": {
                        "type": "diffuse",
                        "reflectance": {"type": "rgb", "value": REFLECTANCE.tolist()},
                    },
                },
            },
        }
    )
    save(make_targets(8000), tmp_path / "targets.safetensors")
    (tmp_path / "state").mkdir()
    return Task(
        name="sheet",
        scene=scene,
        file=tmp_path / "scene.xml",
        size=(WIDTH, HEIGHT),
        exposure=1.0,
        training=(),
        rr_depth=5,
        seed=3,
        state=tmp_path / "state",
        field=SharedField(targets=tmp_path / "targets.safetensors"),
    )


@pytest.fixture(autouse=True)
def tiny(monkeypatch: pytest.MonkeyPatch) -> None:
    shape = CacheShape(GridShape(4, 2, log2_entries=10, coarsest=4, finest=24), (16, 16))
    monkeypatch.setitem(baseline.SHAPES, "small", shape)
    monkeypatch.setattr(fitting, "CHECKPOINT_STEPS", 20)


def prepare(task: Task, report: Callable[[int, int], None] | None = None) -> PreparedCache:
    options = RadianceCacheOptions(
        system="radiance_cache", size="small", steps=STEPS, batch=2048, spp=16
    )
    if report is not None:
        task = Task(**(vars(task) | {"report": report}))
    return RadianceCache(options).prepare(task)


def expected_image(view: View) -> np.ndarray:
    """ρ/π E where the middle of each pixel looks, (H, W, 3)."""
    camera = make_pinhole(view, (WIDTH, HEIGHT))
    y, x = np.indices((HEIGHT, WIDTH)) + 0.5
    across = np.stack([x - WIDTH / 2, y - HEIGHT / 2, np.full_like(x, camera.focal)], -1)
    d = across @ camera.rotation.T
    hit = camera.origin - d * (camera.origin[2] / d[..., 2:])
    light = irradiance_at(hit.reshape(-1, 3), view.origin[2])
    return REFLECTANCE / np.pi * light.reshape(HEIGHT, WIDTH, 3)


def test_both_sides_of_a_sheet_show_their_light(task: Task, asked_to_suppress: list[bool]):
    prepared = prepare(task)
    for view in (ABOVE, BELOW):
        image, expected = prepared.render(view, seed=1), expected_image(view)
        assert image.shape == (HEIGHT, WIDTH, 3) and image.dtype == np.float32
        error = np.sqrt(np.mean((image / expected - 1) ** 2))
        assert error < 0.03, view.name
    assert asked_to_suppress == [True, True]  # fireflies are suppressed, as the field's are
    facts = prepared.facts
    assert 0 < facts["held_out_error"] < 0.05
    assert facts["steps"] == STEPS
    assert prepared.storage_bytes == 4 * facts["parameters"] > 4000


def test_a_killed_training_goes_on(task: Task):
    def kill(done: int, total: int) -> None:
        if done == 70:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        prepare(task, kill)
    seen: list[int] = []
    prepared = prepare(task, lambda done, total: seen.append(done))
    assert seen == list(range(60, STEPS + 1))
    image = prepared.render(ABOVE, seed=1)
    assert np.sqrt(np.mean((image / expected_image(ABOVE) - 1) ** 2)) < 0.03
    # All of it is there now; other targets are another matter.
    prepare(task, lambda done, total: seen.append(-done))
    assert seen[-1] == -STEPS
    save(make_targets(7000), task.field.targets)
    prepare(task, lambda done, total: seen.append(done))
    assert seen[-STEPS - 1 :] == list(range(STEPS + 1))
