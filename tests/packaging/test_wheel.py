"""The wheel: the library alone, which renders where nothing else of the project is installed."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import zipfile
from importlib import metadata
from pathlib import Path

import numpy as np
import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

import gpf
from gpf.field.io import StoredField, write_field
from gpf.field.settings import FieldSettings

pytestmark = pytest.mark.slow

PROJECT = Path(__file__).parent.parent.parent
LIGHT = (3.0, 2.0, 1.0)

RENDER = """
import json, sys
import gpf
import mitsuba as mi

mi.set_variant("llvm_ad_rgb")
t = mi.ScalarTransform4f()
look = t.look_at([0, 0, 2], [0, 0, 0], [0, 1, 0])
scene = mi.load_dict({
    "type": "scene",
    "sensor": {
        "type": "perspective", "fov": 20, "to_world": look,
        "film": {"type": "hdrfilm", "width": 6, "height": 4},
    },
    "floor": {"type": "rectangle", "bsdf": {"type": "diffuse", "reflectance": 0.5}},
    "lamp": {
        "type": "rectangle", "to_world": t.look_at([0, 0, 9], [0, 0, 0], [0, 1, 0]),
        "emitter": {"type": "area"},
    },
})
integrator = mi.load_dict({"type": "gpf", "field": sys.argv[1]})
image = mi.render(scene, integrator=integrator, spp=16)
found = {"mean": [float(image[..., i].array.numpy().mean()) for i in range(3)]}
found["places"] = [gpf.__file__, *sorted({m.split(".")[0] for m in sys.modules})]
print(json.dumps(found))
"""


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> Path:
    """Built from a copy: a build leaves files in its folder."""
    folder = tmp_path_factory.mktemp("wheel")
    unwanted = shutil.ignore_patterns(".*", "results", "build", "*.egg-info", "__pycache__")
    shutil.copytree(PROJECT, folder / "project", ignore=unwanted)
    options = ["--no-deps", "--no-build-isolation", "--quiet", "--wheel-dir", str(folder)]
    pip(["wheel", *options, str(folder / "project")])
    shutil.rmtree(folder / "project")
    (found,) = folder.glob("*.whl")
    return found


@pytest.fixture(scope="module")
def installed(wheel, tmp_path_factory) -> Path:
    """The folder of programs of an environment with the wheel and what it requires, no more."""
    folder = tmp_path_factory.mktemp("installed") / "venv"
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(folder)], check=True)
    pip(["--python", str(folder / "bin/python"), "install", "--no-deps", "--quiet", str(wheel)])
    (packages,) = folder.glob("lib/python*/site-packages")
    (distribution,) = metadata.distributions(name="gaussian-photon-fields", path=[str(packages)])
    for name in required_by(distribution):
        link_distribution(name, packages)
    return folder / "bin"


def pip(arguments: list[str]) -> None:
    subprocess.run([sys.executable, "-m", "pip", *arguments], check=True)


def required_by(distribution: metadata.Distribution) -> set[str]:
    """Names of all packages that a distribution requires, directly or not, without extras."""
    found: set[str] = set()
    todo = [(distribution, frozenset([""]))]
    while todo:
        current, extras = todo.pop()
        for requirement in map(Requirement, current.requires or ()):
            marker = requirement.marker
            if marker and not any(marker.evaluate({"extra": extra}) for extra in extras):
                continue
            name = canonicalize_name(requirement.name)
            if name not in found:
                found.add(name)
                todo.append((metadata.distribution(name), frozenset(["", *requirement.extras])))
    return found


def link_distribution(name: str, packages: Path) -> None:
    """Link the files of a distribution of this environment into another one."""
    distribution = metadata.distribution(name)
    for top in {file.parts[0] for file in distribution.files or () if file.parts[0] != ".."}:
        source = Path(str(distribution.locate_file(top)))
        if top not in ("__pycache__", "bin") and not (packages / top).exists():
            (packages / top).symlink_to(source)


def run(command: list[str], folder: Path) -> str:
    """What a program prints, in a folder outside of the project and with no other variables."""
    done = subprocess.run(
        command,
        cwd=folder,
        env={"PATH": "/usr/bin:/bin", "HOME": str(folder), "COLUMNS": "100"},
        capture_output=True,
        text=True,
        timeout=240,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_the_wheel_has_the_library_and_nothing_else(wheel):
    names = zipfile.ZipFile(wheel).namelist()
    tops = {name.split("/")[0] for name in names}
    assert tops == {"gpf", f"gaussian_photon_fields-{gpf.__version__}.dist-info"}
    code = {path.relative_to(PROJECT).as_posix() for path in PROJECT.glob("gpf/**/*.py")}
    demo = {f"gpf/commands/demo_scene/{file}" for file in ("scene.xml", "views.yaml", "build.py")}
    assert {name for name in names if name.startswith("gpf/")} == code | demo | {
        "gpf/baking/page.html",
        "gpf/__init__.pyi",
        "gpf/blender/addon/blender_manifest.toml",
        "gpf/py.typed",
        "gpf/viewing/page.html",
    }


def test_it_requires_nothing_that_only_the_benchmark_needs(installed):
    (packages,) = installed.parent.glob("lib/python*/site-packages")
    there = {path.name for path in packages.iterdir()}
    assert {"gpf", "mitsuba", "drjit", "numpy"} <= there
    unwanted = {"torch", "dvc", "dvclive", "pandas", "tabulate", "matplotlib", "skimage", "jinja2"}
    unwanted |= {
        "imageio_ffmpeg",
        "h5py",
        "pyoidn",
        "ray",
        "xatlas",
        "baselines",
        "stages",
        "metrics",
        "report",
        "tests",
    }
    assert there & unwanted == set()


def test_the_demo_has_its_scene(installed, tmp_path):
    output = run(
        [
            str(installed / "python"),
            "-c",
            "from pathlib import Path; from gpf.commands.demo import run_demo; "
            "run_demo(Path('demo'), seconds=1)",
        ],
        tmp_path,
    )
    assert output is not None
    pictures = sorted(path.name for path in (tmp_path / "demo" / "pictures").glob("*.png"))
    assert len(pictures) == 5 and (tmp_path / "demo" / "field.safetensors").exists()


def test_it_renders_a_field(installed, tmp_path):
    steps = np.linspace(-1, 1, 21)
    means = np.stack([*np.meshgrid(steps, steps), np.zeros((21, 21))], axis=-1).reshape(-1, 3)
    count = len(means)
    tensors = {
        "means": means,
        "log_scales": np.tile(np.log([0.1, 0.1, 0.01]), (count, 1)),
        "quats": np.tile([0.0, 0.0, 0.0, 1.0], (count, 1)),
        "irradiance": np.tile(LIGHT, (count, 1)),
        "normals": np.tile([0.0, 0.0, 1.0], (count, 1)),
    }
    tensors = {name: value.astype(np.float32) for name, value in tensors.items()}
    bounds = [[-1.0, -1.0, 0.0], [1.0, 1.0, 9.0]]
    field = StoredField(tensors, FieldSettings(search_radius=0.3), bounds, {})
    write_field(field, tmp_path / "field.safetensors")
    output = run([str(installed / "python"), "-c", RENDER, "field.safetensors"], tmp_path)
    found = json.loads(output.splitlines()[-1])
    # Lambert: reflectance / pi times irradiance.
    np.testing.assert_allclose(found["mean"], 0.5 / np.pi * np.array(LIGHT), rtol=1e-3)
    place, *modules = found["places"]
    assert place.startswith(str(installed.parent)) and not {"stages", "torch"} & set(modules)


def test_its_commands(installed, tmp_path):
    text = run([str(installed / "gpf"), "--help"], tmp_path)
    assert "export" in text and "doctor" in text and "stage" not in text
    text = run([str(installed / "gpf"), "doctor"], tmp_path)
    assert "Everything required works" in text and "(no lock file to compare with)" in text
    assert not any(word in text for word in ("dvc", "torch", "LPIPS", "disk"))
    text = run([str(installed / "python"), "-m", "gpf", "--help"], tmp_path)
    assert "python -m gpf" in text and "mitsuba" in text
