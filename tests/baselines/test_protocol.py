"""What a refusal tells on the terminal and what it leaves in files."""

from __future__ import annotations

import pytest

from baselines import optional
from baselines.protocol import CannotServe
from gpf.core.errors import without_folders


@pytest.mark.parametrize(
    ("text", "left"),
    [
        ("/data/code/scene.xml: line 3", "scene.xml: line 3"),
        ("in (/data/a.so), '/data/b.so' and ../../jane/c.so", "in (a.so), 'b.so' and c.so"),
        ("GPF_X=/home/Jane Doe/code has no a/b/c.py", "GPF_X=~/code has no a/b/c.py"),
        ("/home/Jane Doe is no copy", "~ is no copy"),
        ("as https://github.com/a/b has", "as https://github.com/a/b has"),
        ("results/room/views, a / b, no/body, 3/4", "results/room/views, a / b, no/body, 3/4"),
    ],
)
def test_only_the_last_part_of_a_path_is_left(monkeypatch, text, left):
    monkeypatch.setenv("HOME", "/home/Jane Doe")
    assert without_folders(text) == left


def test_the_message_has_the_folders_and_what_is_saved_has_not(monkeypatch):
    def fail(module):
        raise ImportError("/home/jane/libhdf5.so: undefined symbol")

    monkeypatch.setattr(optional.importlib, "import_module", fail)
    with pytest.raises(CannotServe, match="/home/jane/libhdf5.so: undefined") as refusal:
        optional.import_optional("h5py", "h5py")
    assert refusal.value.what == "package not installed: h5py (libhdf5.so: undefined symbol)"
    assert "/home/jane" in refusal.value.told
