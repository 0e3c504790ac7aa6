"""Groups of emitters, and the texts that set their levels."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from gpf.core.errors import UserError
from gpf.scene.light_groups import LightGroups, emitter_names, group_of, parse_levels
from tests.furnace import diffuse, floor, lamp, point_light, rgb


def make_scene(**more):
    return mi.load_dict(
        {
            "type": "scene",
            "floor": floor(diffuse(0.5)),
            "Big Lamp": lamp((0, 0, 2), (0, 0, 0), 0.5, 1, 1, 1),
            "spot": point_light((1, 0, 2), 3, 2, 1),
            "sky": {"type": "constant", "radiance": rgb(0.2)},
            **more,
        }
    )


@pytest.fixture(scope="module")
def scene():
    return make_scene()


def test_emitters_have_the_names_of_the_scene_file(scene):
    assert sorted(emitter_names(scene)) == ["big_lamp", "sky", "spot"]


def test_each_emitter_is_a_group(scene):
    groups = LightGroups.each(scene)
    assert groups.names == tuple(emitter_names(scene))
    assert sorted(k for members in groups.members for k in members) == [0, 1, 2]


def test_too_many_emitters_need_a_file():
    many = {f"lamp_{k}": point_light((k, 0, 2), 1, 1, 1) for k in range(20)}
    with pytest.raises(UserError, match="would make 23 groups.*List the groups in a file"):
        LightGroups.each(make_scene(**many))


def test_a_file_joins_emitters_and_the_rest_is_other(scene, tmp_path):
    file = tmp_path / "groups.yaml"
    file.write_text("lamps: [big_lamp, spot]\n")
    groups = LightGroups.read(file, scene)
    names = emitter_names(scene)
    assert groups.names == ("lamps", "other")
    assert groups.members[0] == (names.index("big_lamp"), names.index("spot"))
    assert groups.members[1] == (names.index("sky"),)


def test_frames_without_some_of_the_emitters(scene):
    groups = LightGroups.each(scene)
    fewer = make_scene(spot=floor(diffuse(0.5)))  # in its place, a shape that does not emit
    names = emitter_names(fewer)
    found = groups.in_frame(fewer)
    assert found.names == groups.names and found.members[groups.names.index("spot")] == ()
    for name in ("big_lamp", "sky"):
        assert found.members[groups.names.index(name)] == (names.index(name),)
    with pytest.raises(UserError, match="emitter new: is in none of the groups"):
        groups.in_frame(make_scene(new=point_light((0, 0, 1), 1, 1, 1)))


def test_emitters_without_ids_are_not_mixed_up():
    """The second of three, or the third? But others may be missing."""

    def scene(*lamps):
        place = '<point name="center" x="{}" y="0" z="0"/>'
        shape = f'<shape type="sphere">{place}<emitter type="area"/></shape>'
        point = '<emitter type="point" id="spark"/>'
        text = "".join(point if x == "spark" else shape.format(x) for x in lamps)
        return mi.load_string(f'<scene version="3.0.0">{text}</scene>')

    groups = LightGroups.each(scene(1, 2, 3, "spark"))
    assert set(groups.names) == {"arealight", "arealight_2", "arealight_3", "spark"}
    found = groups.in_frame(scene(1, 2, 3))
    assert found.members[groups.names.index("spark")] == ()
    with pytest.raises(UserError, match="arealight_3: has no name .*fewer arealights.*ids"):
        groups.in_frame(scene(1, 3, "spark"))


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (
            "lamps: [bg_lamp]",
            "lamps: lists 'bg_lamp', which is not an emitter. Did you mean 'big_lamp'",
        ),
        ("a: [spot]\nb: [spot]", "b: lists spot, which is also in a"),
        ("a: []", "a"),
        ("A b: [spot]", "A b"),
        ("[spot]", "groups.yaml"),
    ],
)
def test_a_wrong_file_is_explained(scene, tmp_path, text, says):
    file = tmp_path / "groups.yaml"
    file.write_text(text)
    with pytest.raises(UserError) as refused:
        LightGroups.read(file, scene)
    assert says in str(refused.value)


def test_rays_know_their_group(scene):
    groups, names = LightGroups.each(scene), emitter_names(scene)
    table, sampler = groups.table(scene), mi.load_dict({"type": "independent"})
    sampler.seed(1, 3000)
    ray, _, emitter = scene.sample_emitter_ray(
        0, sampler.next_1d(), sampler.next_2d(), sampler.next_2d(), True
    )
    found = np.array(group_of(table, emitter))
    start = np.array(ray.o).T
    at_spot = np.linalg.norm(start - [1, 0, 2], axis=1) < 1e-3
    at_lamp = (np.abs(start[:, :2]).max(axis=1) < 0.26) & (np.abs(start[:, 2] - 2) < 1e-3)
    assert at_spot.any() and at_lamp.any()
    assert (found[at_spot] == names.index("spot")).all()
    assert (found[at_lamp] == names.index("big_lamp")).all()
    assert (found[~at_spot & ~at_lamp] == names.index("sky")).all()
    assert dr.width(table) > 3 or len(table) >= 3


def test_levels_from_a_text():
    found = parse_levels("window=0.2, lamp = 1.5, #ff8000,", ["window", "lamp", "sky"])
    assert found["window"] == (0.2, 0.2, 0.2)
    np.testing.assert_allclose(found["lamp"], (1.5, 1.5 * 0.2158605, 0), atol=1e-6)
    assert parse_levels("", ["window"]) == {}


@pytest.mark.parametrize(
    "text", ["windw=1", "window", "window=-1", "window=x", "window=1,#12", "#ffffff"]
)
def test_texts_that_are_no_levels_are_explained(text):
    with pytest.raises(UserError, match=r"^lights"):
        parse_levels(text, ["window"])
