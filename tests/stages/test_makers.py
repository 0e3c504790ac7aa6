"""Which command makes a file, and errors that name it."""

from pathlib import Path

import pytest

from gpf.core.errors import FileError, UserError
from stages.common.makers import command_for, naming_commands


@pytest.mark.parametrize(
    ("path", "command"),
    [
        ("results/kitchen/scene/scene.xml", "gpf stage scene --scene kitchen"),
        ("results/kitchen/field.safetensors", "gpf stage train --scene kitchen"),
        ("results/kitchen/targets.safetensors", "gpf stage reference --scene kitchen"),
        ("/a/results/kitchen/reference/x.exr", "gpf stage reference --scene kitchen"),
        ("/results/old/results/kitchen/field.safetensors", "gpf stage train --scene kitchen"),
        ("results/kitchen/renders/gpf/x.exr", "gpf stage render --scene kitchen"),
        ("results/kitchen/renders/mine/x.exr", "gpf stage baseline --method mine --scene kitchen"),
        ("results/kitchen/costs/train.json", "gpf stage train --scene kitchen"),
        ("results/kitchen/notes.txt", None),
        ("results/field.safetensors", None),
        ("elsewhere/field.safetensors", None),
    ],
)
def test_the_command_that_makes_a_file(path, command):
    assert command_for(Path(path)) == command


@pytest.mark.parametrize(
    ("file", "missing", "todo"),
    [
        ("results/box/field.safetensors", True, "Run `gpf stage train --scene box` first."),
        ("results/box/photons.safetensors", False, "Delete it and run `gpf stage photons"),
        ("field.safetensors", True, "Check the path."),
    ],
)
def test_errors_about_files_name_the_command(file, missing, todo):
    with pytest.raises(UserError) as caught, naming_commands():
        raise FileError(Path(file), "is odd", missing)
    assert str(caught.value).startswith(f"{file}: is odd. {todo}")
