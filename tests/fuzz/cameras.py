"""Files of cameras: views.yaml and transforms.json."""

from __future__ import annotations

from hypothesis import strategies as st

from tests.fuzz import documents, meshes
from tests.fuzz.case import Case, Files
from tests.fuzz.good import SCENE, TRANSFORMS, VIEWS, good_fields

WORDS = ("render", "scene.xml", "--size", "4", "--spp", "1", "--no-denoise")
CHOICES = ("", "--frames all", "--frames 1:2", "--view left", "--views views.yaml")


@st.composite
def cases(draw: st.DrawFn) -> Case:
    """`gpf render` with a file of cameras."""
    files: Files = {"scene.xml": SCENE.encode(), "field.safetensors": good_fields()["plain"]}
    if draw(st.booleans()):
        words = (*WORDS, *draw(st.sampled_from(CHOICES)).split())
        files |= {"views.yaml": documents.changed_yaml(draw, VIEWS)}
        return Case(words, ("pictures/*",), ("views.yaml", "view '"), files)
    tree = dict(TRANSFORMS)
    if draw(st.booleans()):  # the size is that of the pictures
        del tree["w"], tree["h"]
        files |= {frame["file_path"]: draw(meshes.files("png")) for frame in tree["frames"]}
    files |= {"cameras.json": documents.changed_json(draw, tree)}
    words = (*WORDS, "--views", "cameras.json")
    return Case(words, ("pictures/*",), ("cameras.json", ".png"), files)
