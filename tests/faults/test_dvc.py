"""The pipeline under DVC: two runs at once, a killed one, and a damaged cache."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from ruamel.yaml import YAML

from tests.faults.runner import ENVIRONMENT
from tests.faults.wholeness import contents
from tests.made_once import made_once
from tests.stages.conftest import SCENE, Project, new_project
from tests.stages.pipeline import Checkout

pytest.importorskip("dvc")
pytestmark = pytest.mark.slow

TRAIN, PHOTONS = f"train@{SCENE}", f"photons@{SCENE}"


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Project:
    """A project whose field is trained; not to be changed."""

    def make(folder: Path) -> None:
        checkout = Checkout.make(new_project(folder / "project"), folder / "bin", ENVIRONMENT)
        checkout.dvc("repro", TRAIN)

    return Project(made_once(tmp_path_factory, "dvc_project", make) / "project")


@pytest.fixture
def checkout(made, tmp_path) -> Checkout:
    return Checkout.at(made.copy(tmp_path / "project"), tmp_path / "bin", ENVIRONMENT)


@contextmanager
def training(checkout: Checkout) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """DVC, whose training stage rests until the end of the block, and who that stage is."""
    checkout.project.edit("params.yaml", train__steps=400)
    lock = checkout.project.results / ".lock-train"
    with checkout.start_dvc("repro", TRAIN) as dvc:
        deadline = time.monotonic() + 90
        while not (lock.exists() and (holder := lock.read_text())):
            assert time.monotonic() < deadline and dvc.poll() is None
            time.sleep(0.02)
        stage = int(holder.split()[1])
        os.kill(stage, signal.SIGSTOP)
        try:
            yield dvc, holder
        finally:
            os.kill(stage, signal.SIGCONT)
            dvc.communicate(timeout=200)  # until the stage has ended, too: the pipe is its own


def test_two_at_once(checkout):
    """DVC's own lock keeps the second away, and says which process holds it."""
    alone = checkout.project.copy(checkout.project.folder.with_name("alone"))
    with training(checkout) as (dvc, _):
        said = checkout.dvc_fails("repro", TRAIN)
        assert re.search(rf"is busy, it is being blocked by:\s+\(PID {dvc.pid}\)", said), said
    assert dvc.returncode == 0
    alone.edit("params.yaml", train__steps=400)
    assert alone.stage("train").code == 0
    assert trained(checkout.project) == trained(alone)
    assert "up to date" in checkout.dvc("repro", TRAIN)


def test_only_dvc_is_killed(checkout):
    """Its stage goes on. DVC sees that the process of its lock is gone; ours says who is at work,
    and the run after it finishes."""
    with training(checkout) as (dvc, holder):
        dvc.kill()
        dvc.wait()
        said = " ".join(checkout.dvc_fails("repro", TRAIN).split())
        assert f"results/{SCENE}/train: is being made by {holder}" in said
        assert "Traceback" not in said
    before = trained(checkout.project)
    assert f"{SCENE}/field.safetensors" in before
    checkout.dvc("repro", TRAIN)
    assert trained(checkout.project) == before


def trained(project: Project) -> dict[str, str]:
    """The field and its curves."""
    found = contents(project.folder / "results")
    return {
        name: value
        for name, value in found.items()
        if re.search(r"/(field|training)\b", name) and ".gitignore" not in name
    }


def cached(checkout: Checkout, out: str) -> Path:
    """Where DVC's cache has an output."""
    lock = YAML(typ="safe").load((checkout.project.folder / "dvc.lock").read_text())
    outs = [out for stage in lock["stages"].values() for out in stage["outs"]]
    name = next(o["md5"] for o in outs if o["path"] == f"results/{SCENE}/{out}")
    return checkout.project.folder / ".dvc/cache/files/md5" / name[:2] / name[2:]


@pytest.mark.parametrize("out", ["photons.safetensors", "reference"])
def test_the_cache_misses_an_entry(checkout, out):
    place, stage = checkout.project.results / out, PHOTONS if "." in out else f"reference@{SCENE}"
    before = contents(checkout.project.results)
    cached(checkout, out).unlink()
    place.rename(checkout.project.folder / "away")
    assert re.search(rf"Checkout failed.*\s+\S+/{out}\s", checkout.dvc_fails("checkout", stage))
    checkout.dvc("repro", TRAIN)
    assert contents(checkout.project.results) == before


def cut(path: Path) -> None:
    """Keep half of a file and its permissions."""
    mode, data = path.stat().st_mode, path.read_bytes()
    path.chmod(0o644)
    path.write_bytes(data[: len(data) // 2])
    path.chmod(mode)


def flip(path: Path) -> None:
    """Flip a bit of a file, and keep its permissions."""
    mode, data = path.stat().st_mode, bytearray(path.read_bytes())
    data[len(data) // 2] ^= 4
    path.chmod(0o644)
    path.write_bytes(data)
    path.chmod(mode)


@pytest.mark.parametrize("damage", [cut, flip])
def test_the_cache_has_a_damaged_entry(checkout, damage):
    """DVC does not look into a read-only file of its cache, and brings it back. The stage that
    reads it says what to do, with which the cache is whole again."""
    place = checkout.project.results / "photons.safetensors"
    whole, entry = place.read_bytes(), cached(checkout, place.name)
    damage(entry)
    place.unlink()
    checkout.dvc("checkout", PHOTONS)
    assert place.read_bytes() != whole  # if not, DVC has learned to look: the message can be short
    checkout.project.edit("params.yaml", train__seed=13)
    said = " ".join(checkout.dvc_fails("repro", TRAIN).split())
    found = re.search(rf"{place.name}: is .*damaged.* Delete it and run `([^`]+)` again(.*)", said)
    assert found is not None and "Traceback" not in said, said
    cure = re.search(r"If DVC restores the damaged file, run `([^`]+)` first", found[2])
    assert cure is not None, said
    checkout.call(*cure[1].split())
    place.unlink()
    checkout.call(*found[1].split())
    checkout.dvc("repro", TRAIN)
    assert place.read_bytes() == entry.read_bytes() == whole
