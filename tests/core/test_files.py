"""Files are whole or absent, and say what is wrong with them."""

import json
import re
import subprocess
import sys

import numpy as np
import pytest
from safetensors.numpy import save_file

from gpf.core.errors import FileError, UserError
from gpf.core.files import (
    SCHEMA_VERSION,
    read_json,
    read_tensors,
    require_shapes,
    write_atomically,
    write_json,
    write_tensors,
    write_text,
)

TENSORS = {
    "means": np.arange(12, dtype=np.float32).reshape(4, 3)[:, ::-1],
    "depth": np.array([1, 2, 250], np.uint32),
    "none": np.zeros((0, 3), np.float32),
}


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "deep" / "down" / "photons.safetensors"
    write_tensors(path, "photons", TENSORS, {"paths": 7, "nested": {"a": [1.5, None, "ü"]}})
    return path


def others(path) -> list[str]:
    """What else lies in the folder of a file."""
    return sorted(p.name for p in path.parent.iterdir() if p != path)


# --- tensors ----------------------------------------------------------------------------------


def test_tensors_come_back_as_they_were(file):
    tensors, metadata = read_tensors(file, "photons")
    assert tensors.keys() == TENSORS.keys()
    for name, value in TENSORS.items():
        np.testing.assert_array_equal(tensors[name], value)
        assert (tensors[name].dtype, tensors[name].shape) == (value.dtype, value.shape)
    assert metadata == {"paths": 7, "nested": {"a": [1.5, None, "ü"]}}
    assert others(file) == []


def test_the_same_content_is_the_same_file(file, tmp_path):
    again = tmp_path / "again.safetensors"
    write_tensors(again, "photons", TENSORS, {"nested": {"a": [1.5, None, "ü"]}, "paths": 7})
    assert again.read_bytes() == file.read_bytes()


def test_a_missing_file(tmp_path):
    with pytest.raises(FileError, match=r"gone\.safetensors: is missing\. Check the path"):
        read_tensors(tmp_path / "gone.safetensors", "photons")


@pytest.mark.parametrize("share", [*np.arange(10) / 10, 0.001, 0.9999])
def test_a_truncated_file(file, share):
    data = file.read_bytes()
    file.write_bytes(data[: int(len(data) * share)])
    with pytest.raises(
        FileError,
        match=r"photons\.safetensors: is truncated or damaged \(.+\)\. Delete it and make it again",
    ):
        read_tensors(file, "photons")


def test_another_kind(file):
    with pytest.raises(FileError, match=r"holds photons, not field\. Delete it and make it"):
        read_tensors(file, "field")


def test_a_foreign_file(tmp_path):
    path = tmp_path / "foreign.safetensors"
    save_file({"x": np.ones(3, np.float32)}, path)
    with pytest.raises(FileError, match="holds something else, not field"):
        read_tensors(path, "field")


def test_another_schema_version(tmp_path):
    path = tmp_path / "field.safetensors"
    header = {"kind": "field", "schema_version": "99", "metadata": "{}"}
    save_file({"x": np.ones(3, np.float32)}, path, metadata=header)
    with pytest.raises(
        FileError,
        match=rf"field\.safetensors: has schema version 99; this program reads {SCHEMA_VERSION}\. "
        r"Delete it and make it again",
    ):
        read_tensors(path, "field")


# --- atomic writes ----------------------------------------------------------------------------


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
def test_a_failing_writer_leaves_the_old_file_and_nothing_else(tmp_path, error):
    path = tmp_path / "table.csv"
    write_text(path, "old")

    def fail(temporary):
        temporary.write_text("half")
        raise error

    with pytest.raises(error):
        write_atomically(path, fail)
    assert path.read_text() == "old"
    assert others(path) == []


def test_a_full_disk_is_said_in_words(tmp_path):
    path = tmp_path / "table.csv"
    write_text(path, "old")

    def fail(temporary):
        temporary.write_text("half")
        raise OSError(28, "No space left on device")

    with pytest.raises(
        UserError, match=r"table\.csv: could not be written .*No space left.*Free some disk space"
    ):
        write_atomically(path, fail)
    assert path.read_text() == "old"
    assert others(path) == []


def test_a_folder_that_cannot_be_made_is_said_in_words(tmp_path):
    (tmp_path / "results").write_text("a file where the folder should be")
    path = tmp_path / "results" / "scene" / "table.csv"
    with pytest.raises(UserError, match=r"table\.csv: could not be written .*check the folder"):
        write_text(path, "new")
    assert (tmp_path / "results").is_file()


def test_the_writer_sees_the_suffix_and_the_folder(tmp_path):
    path = tmp_path / "figure.svg"
    seen = []

    def write(temporary):
        seen.append(temporary)
        temporary.write_text("x")

    write_atomically(path, write)
    assert seen[0].suffix == ".svg" and seen[0].parent == tmp_path and seen[0] != path
    assert path.read_text() == "x"


@pytest.mark.parametrize(
    ("umask", "file", "folder"), [(0o077, 0o600, 0o700), (0o002, 0o664, 0o775)]
)
def test_permissions_follow_umask(tmp_path, umask, file, folder):
    """As those of files that other programs of the user make."""
    code = f"""
import os
os.umask({umask})
from pathlib import Path
from gpf.core.files import write_text
from gpf.core.partial import grant_as_usual
write_text(Path("a.txt"), "x")
Path("b").mkdir(0o700)
grant_as_usual(Path("b"))
"""
    subprocess.run([sys.executable, "-c", code], check=True, cwd=tmp_path)
    found = [(tmp_path / name).stat().st_mode & 0o777 for name in ("a.txt", "b")]
    assert found == [file, folder]


# --- JSON -------------------------------------------------------------------------------------


def test_json_is_sorted_and_comes_back(tmp_path):
    path = tmp_path / "numbers.json"
    write_json(path, {"b": [1, 2.5, None], "a": {"z": 1, "c": "x"}})
    assert path.read_text().endswith("}\n")
    assert list(json.loads(path.read_text())) == ["a", "b"]
    assert read_json(path) == {"b": [1, 2.5, None], "a": {"z": 1, "c": "x"}}


def test_missing_and_truncated_json(tmp_path):
    path = tmp_path / "numbers.json"
    with pytest.raises(FileError, match=r"numbers\.json: is missing\. Check the path"):
        read_json(path)
    path.write_text('{"a": [1, 2')
    with pytest.raises(FileError, match=r"is not JSON \(.*\)\. Delete it and make it again"):
        read_json(path)


def test_the_errors_words_are_its_three_parts():
    error = UserError("file: key", "is -1", "Give 0 or more")
    assert re.fullmatch(r"file: key: is -1\. Give 0 or more", str(error))
    assert (error.where, error.what, error.todo) == ("file: key", "is -1", "Give 0 or more")
    assert error.exit_code == 2


# --- damage -----------------------------------------------------------------------------------


def test_a_flipped_bit_is_noticed_or_changes_nothing(file):
    data = file.read_bytes()
    for bit in range(0, 8 * len(data), 13):
        flipped = bytearray(data)
        flipped[bit // 8] ^= 1 << (bit % 8)
        file.write_bytes(flipped)
        try:
            tensors, metadata = read_tensors(file, "photons")
        except FileError:
            continue
        assert metadata == {"paths": 7, "nested": {"a": [1.5, None, "ü"]}}, bit
        assert tensors.keys() == TENSORS.keys(), bit
        for name, value in TENSORS.items():
            np.testing.assert_array_equal(tensors[name], value, err_msg=f"bit {bit}")


def test_files_without_a_checksum_are_read(tmp_path):
    path = tmp_path / "old.safetensors"
    header = {"kind": "field", "schema_version": str(SCHEMA_VERSION), "metadata": '{"a": 1}'}
    save_file({"x": np.ones(3, np.float32)}, path, metadata=header)
    assert read_tensors(path, "field")[1] == {"a": 1}


@pytest.mark.parametrize("size", [2**62, 10**9, 5000])
def test_a_header_of_gigabytes_is_not_read(file, size):
    file.write_bytes(size.to_bytes(8, "little") + file.read_bytes()[8:])
    with pytest.raises(FileError, match=f"damaged .its header would have {size} bytes"):
        read_tensors(file, "photons")


def test_an_array_that_a_file_does_not_have(file):
    tensors, _ = read_tensors(file, "photons")
    assert "colours" not in tensors and tensors.get("colours") is None
    with pytest.raises(FileError, match=r"photons\.safetensors: has no tensor colours\. Delete"):
        tensors["colours"]


@pytest.mark.parametrize(
    ("colour", "words"),
    [
        (None, "has no tensor colour"),
        (np.zeros((4, 3), np.float32), r"has colour of shape .4, 3., float32, not .5, 3., f4"),
        (np.zeros((5, 3)), r"has colour of shape .5, 3., float64, not"),
        (np.zeros(5, np.float32), r"has colour of shape .5,., float32, not"),
    ],
)
def test_tensors_of_another_shape_or_type(tmp_path, colour, words):
    wanted = {"position": (("N", 3), "f4"), "colour": (("N", 3), "f4")}
    tensors = {"position": np.zeros((5, 3), np.float32)}
    require_shapes(tmp_path, tensors | {"colour": np.ones((5, 3), np.float32)}, wanted)
    with pytest.raises(FileError, match=words):
        require_shapes(tmp_path, tensors | ({} if colour is None else {"colour": colour}), wanted)


# --- JSON that is not what it should be ---------------------------------------------------------


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b'{"name": "\xff"}', r"costs\.json: is not JSON \('utf-8' codec can't decode"),
        (b"[" * 100_000, r"is not JSON \(maximum recursion depth"),
        (b"9" * 5000, r"is not JSON \(Exceeds the limit"),
        (b'{"parts": [1]}', r"has the wrong structure \(parts: Input should be an object"),
        (b"[]", r"has the wrong structure \(the whole file: Input should be an object"),
        (b'{"parts": {"a": "b"}}', r"wrong structure \(parts\.a: Input should be a valid number"),
        (
            b'{"parts": {"a": "1.5"}}',
            r"has the wrong structure \(parts\.a: Input should be a valid number",
        ),
    ],
)
def test_json_of_another_form_is_told(tmp_path, data, words):
    path = tmp_path / "costs.json"
    path.write_bytes(data)
    with pytest.raises(FileError, match=words):
        read_json(path, dict[str, dict[str, float]])


def test_a_folder_in_place_of_json_is_told(tmp_path):
    with pytest.raises(FileError, match=r"cannot be read \(Is a directory\)"):
        read_json(tmp_path)


@pytest.mark.parametrize("metadata", [None, "{", "[]", "[" * 100_000])
def test_metadata_of_another_form_are_told(tmp_path, metadata):
    path = tmp_path / "photons.safetensors"
    header = {"kind": "photons", "schema_version": str(SCHEMA_VERSION)}
    header |= {} if metadata is None else {"metadata": metadata}
    save_file({"a": np.zeros(3, np.float32)}, path, metadata=header)
    with pytest.raises(FileError, match=r"is not JSON|has the wrong structure"):
        read_tensors(path, "photons")
