"""Profiles: every one gives valid parameters, and switching rewrites params.yaml visibly."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest
from ruamel.yaml import YAML

from gpf.core.errors import UserError
from stages.commands.profiles import EVERY, apply_profile, read_profiles
from stages.config.params import Params, read_params

PROJECT = Path(__file__).parent.parent.parent
NAMES = ("quick", "desk", "full", "paper", "smoke")
OWN = "quick"
"""The profile of the project's params.yaml."""


@pytest.fixture
def params(tmp_path: Path) -> Path:
    return Path(shutil.copy(PROJECT / "params.yaml", tmp_path))


def values(file: Path) -> dict:
    return YAML(typ="safe").load(file.read_text(encoding="utf-8"))


def look_up(params: Params, key: str) -> object:
    value: object = params
    for part in key.split("."):
        value = getattr(value, part)
    return list(value) if isinstance(value, tuple) else value


def test_rows_that_the_project_does_not_have_are_left_out(params):
    text = re.sub(r"\n  splatting_10: .*", "", params.read_text())
    params.write_text(text)
    apply_profile("full", params)
    read = read_params(params)
    assert "splatting_3" in read.methods.learned and "splatting_10" not in read.methods.learned
    assert "splatting_10" not in read.animation.methods


def test_values_that_do_not_go_together_are_refused_before_anything_is_said(params, capsys):
    text = params.read_text()
    params.write_text(text.replace("direct: auto ", "direct: emitters "))
    before = params.read_text()
    with pytest.raises(UserError, match=r"with profile paper: .*field\.direct is emitters, but"):
        apply_profile("paper", params)
    said = "".join(capsys.readouterr())
    assert params.read_text() == before and " -> " not in said


def test_there_are_five():
    assert tuple(read_profiles()) == NAMES


def test_all_set_the_same_keys():
    keys = [set(profile) for profile in read_profiles().values()]
    assert all(k == keys[0] for k in keys)  # switching back and forth leaves nothing behind


@pytest.mark.parametrize("name", NAMES)
def test_every_profile_gives_valid_params(params, name):
    apply_profile(name, params)
    read = read_params(params)
    for key, value in read_profiles()[name].items():
        wanted = list(read.ablations.variants) if value == EVERY else value
        assert look_up(read, key) == wanted


def test_all_variants_are_those_that_the_project_has(params):
    params.write_text(
        params.read_text().replace(
            "  variants: ", "  variants:\n    mine: {group: k, set: {field.k: 7}} "
        )
    )
    apply_profile("full", params)
    read = read_params(params)
    assert read.ablations.run == tuple(read.ablations.variants) and "mine" in read.ablations.run


def test_a_profile_asks_for_no_scene_that_the_project_lacks(params):
    params.write_text(
        re.sub(r"  scenes: \[.*\]", "  scenes: []", params.read_text()).replace(
            "  - water_caustic\n", ""
        )
    )
    apply_profile("full", params)
    read = read_params(params)
    assert read.ablations.scenes == ("cornell_box",)
    assert read.animation.scenes == ("water_caustic_2",)


def test_the_projects_params_are_a_profile():
    read = read_params(PROJECT / "params.yaml")
    found = {key: look_up(read, key) for key in read_profiles()[OWN]}
    assert found == dict(read_profiles()[OWN])


def test_desk_and_full_are_what_they_are_for():
    profiles = read_profiles()
    assert profiles["desk"]["film.height"] == profiles["full"]["film.height"] == 256
    assert profiles["desk"]["reference.passes"] >= 250
    assert profiles["full"]["reference.passes"] == 1000


def test_switching_there_and_back_restores_the_file(params):
    before = params.read_text(encoding="utf-8")
    apply_profile("smoke", params)
    assert params.read_text(encoding="utf-8") != before
    apply_profile(OWN, params)
    assert params.read_text(encoding="utf-8") == before


def test_comments_and_other_values_stay(params):
    params.write_text(params.read_text().replace("  alpha: 0.7 ", "  alpha: 0.6 "))
    lines = params.read_text(encoding="utf-8").splitlines()
    apply_profile("smoke", params)
    after = params.read_text(encoding="utf-8").splitlines()
    assert len(lines) == len(after)
    assert values(params)["reference"]["alpha"] == 0.6
    changed = [new for old, new in zip(lines, after, strict=True) if old != new]
    keys = {key.split(".")[1] for key in read_profiles()["smoke"]}
    assert {line.split(":")[0].strip() for line in changed} <= keys
    for old, new in zip(lines, after, strict=True):
        assert [c.strip() for c in old.split("#")[1:]] == [c.strip() for c in new.split("#")[1:]]


def test_what_changed_is_said(params, capfd):
    apply_profile("full", params)
    text = re.sub(r"\s+", " ", capfd.readouterr().err)
    before = read_profiles()[OWN]["reference.passes"]
    assert f"reference.passes: {before} -> 1000" in text
    assert "methods.learned: [] -> ['radiance_cache'," in text
    assert "photons.paths" not in text
    own, full = (read_profiles()[name] for name in (OWN, "full"))
    count = sum(own[key] != full[key] for key in full)
    assert count > 10 and re.search(rf"params\.yaml: profile full, {count} values changed", text)
    apply_profile("full", params)
    assert "0 values changed" in re.sub(r"\s+", " ", capfd.readouterr().err)


def test_a_file_that_is_not_in_order_is_left_alone(params):
    params.write_text(params.read_text().replace("  alpha: 0.7", "  alpha: 7"))
    before = params.read_bytes()
    with pytest.raises(UserError, match=r"reference\.alpha: is 7\. Input should be less than 1"):
        apply_profile("smoke", params)
    assert params.read_bytes() == before


def test_a_section_that_is_left_out_is_added(params):
    text = params.read_text(encoding="utf-8")
    params.write_text(re.sub(r"render:\n(  .*\n)+", "", text), encoding="utf-8")
    assert "render" not in values(params)
    apply_profile("smoke", params)
    assert values(params)["render"] == {"spp": 4}


def test_an_unknown_profile_is_said_in_words(params):
    before = params.read_bytes()
    with pytest.raises(
        UserError,
        match=r"profile 'desc': does not exist\. Did you mean 'desk'\? Profiles are quick, desk, f",
    ):
        apply_profile("desc", params)
    assert params.read_bytes() == before
