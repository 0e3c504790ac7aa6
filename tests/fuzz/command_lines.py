"""Command lines: options that are missing, doubled, or have values that nobody expects."""

from __future__ import annotations

import random
from pathlib import Path

from tests.fuzz import odd
from tests.fuzz.case import Case
from tests.fuzz.scenes import make_first_scene
from tests.fuzz.settings import good_text

NUMBERS = ("0", "-1", "1", "3", "0.5", "nan", "inf", "-inf", "1e-9", "1e30", "1e400", "2147483648")
NUMBERS += ("18446744073709551616", "9" * 40, "9" * 5000, "x", "", "1_000", "٣", "0x10", "1e3")

# Command -> its arguments, and options with words that may follow them.
FILES = ("scene.xml", "field.safetensors", "views.yaml", "transforms.json", ".", "missing", "bytes")
FILES += ("/dev/null", "folder", "folder/x.safetensors", "scene.xml/x", "")
COMMANDS: dict[str, tuple[tuple[str, ...], dict[str, tuple[str, ...]]]] = {
    "render": (
        ("scene.xml",),
        {
            "--field": ("field.safetensors", *FILES),
            "--view": ("eye", "", "x"),
            "--views": ("views.yaml", "transforms.json", *FILES),
            "--frames": ("all", "0:1", ":", "1:0", "x"),
            "--orbit": ("2", "0", "-1", "x", "1000000000", "9" * 40),
            "--output": ("out", *FILES),
            "--size": ("5x4", "4", "0x0", "x", "5x4x3", "-4", "1e3", "99999x9", "16384x16384"),
            "--spp": ("1", *NUMBERS),
            "--seconds": ("0.1", "nan", "-1", "0", "1e-9"),
            "--aovs": ("depth", "depth,depth", "error,coverage", ",", "x", "Depth"),
            "--exposure": ("1", *NUMBERS),
            "--no-denoise": (),
            "--mp4": (),
            "--seed": ("1", *NUMBERS),
            "--changed-scene": (),
            "--executor": ("local", "x"),
            "--cluster": ("", "x"),
            "--lights": ("lamp=0.5", "lamp=nan", "lamp", "=", "sky=1,#ffd0a0", "#zz", "sky=1e400"),
        },
    ),
    "fit": (
        ("scene.xml",),
        {
            "--output": ("out.safetensors", *FILES),
            "--seconds": ("1", "nan", "-1", "0", "1e-9"),
            "--target-psnr": ("1", "nan", "-1", "0", "-inf"),
            "--views": ("views.yaml", "transforms.json", *FILES),
            "--seed": ("1", *NUMBERS),
            "--continue": ("field.safetensors", *FILES),
            "--groups": ("auto", *FILES),
        },
    ),
    "view": (
        ("scene.xml", "--no-open", "--field", "field.safetensors"),
        {
            "--output": FILES,
            "--views": ("views.yaml", *FILES),
            "--host": ("127.0.0.1", "localhost", "", "x", "999.9.9.9", "1.2.3.4", "::1", "a" * 300),
            "--port": ("0", "80", "-1", "65535", "99999", "x"),
            "--groups": ("auto", "x"),
            "--changed-scene": (),
        },
    ),
    "mitsuba": (
        ("scene.xml",),
        {
            "--output": ("out.exr", "out.PNG", "out.jpg", "out.xyz", *FILES),
            "--define": ("spp=2", "x", "=", "filename=x", "config=1"),
            "--sensor": ("0", *NUMBERS),
            "--spp": ("1", *NUMBERS),
            "--seed": ("1", *NUMBERS),
        },
    ),
    "export": (
        ("field.safetensors",),
        {
            "--ply": ("out.ply", "out.PLY", *FILES),
            "--compact": ("out.safetensors", *FILES),
            "--exposure": ("1", *NUMBERS),
        },
    ),
    "lights": (("field.safetensors",), {}),
    "demo": (("scenes",), {}),
    "profile": (("smoke",), {}),
    "scene list": ((), {}),
    "scene import": (("scenes/first",), {"--name": ("room", "first", "..", "true", "x" * 300)}),
    "scene preview": (("second",), {"--name": ("first",)}),
    "stage scene": ((), {"--scene": ("first", "second", "", "../first", ".")}),
    "stage reference": (
        ("--scene", "first"),
        {"--passes": ("0:1", "x", "1:0", ":", "9" * 5000 + ":1", "-1:2")},
    ),
    "stage baseline": (("--scene", "first"), {"--method": ("path_10", "x"), "--go-on": ()}),
    "stage ablation": (("--scene", "first"), {"--variant": ("all", "x"), "--go-on": ()}),
}  # fmt: skip
WRITTEN = (
    "out/*",
    "gpf-demo/*",
    "out.*",
    "scene.exr",
    "pictures/*",
    "scenes/room/*",
    "results/*",
    "params.yaml",
    "folder/*",
)
WRITTEN += ("field.safetensors", "field.png", "field.fit/*", "missing/*", "bytes/*", "scene.xml")


def words_of(rng: random.Random) -> list[str]:
    """A command line; some of its words may be wrong."""
    command = rng.choice(
        [*COMMANDS, *["render"] * 3, *["mitsuba"] * 2, "fit", "export", "stage scene"]
    )
    arguments, options = COMMANDS[command]
    words = [*command.split(), *arguments]
    cheap = {"render": ["--size", "5x4", "--spp", "1"], "fit": ["--passes", "2"]}
    cheap["mitsuba"] = ["--spp", "1"]
    words += cheap.get(command, [])
    for option in rng.sample(list(options), min(len(options), rng.choice([0, 1, 1, 2, 3]))):
        words.append(option)
        if options[option]:
            few = rng.random() < 0.1
            words.append(odd.text(rng) if few else rng.choice(options[option]))
    if rng.random() < 0.15:
        at = rng.randrange(len(words))
        way = rng.choice(["drop", "double", "change", "option"])
        if way == "drop":
            del words[at]
        elif way == "double":
            words.insert(at, words[at])
        else:
            words[at] = odd.text(rng) if way == "change" else "--" + odd.text(rng)
    return words


def make_case(rng: random.Random, folder: Path, good: Path) -> Case:
    """A command line in a folder of good files."""
    make_first_scene(folder, good)
    (folder / "params.yaml").write_text(good_text())
    (folder / "folder").mkdir()
    (folder / "bytes").write_bytes(rng.randbytes(100))
    for name in ("scene.xml", "field.safetensors", "transforms.json", "views.yaml"):
        (folder / name).write_bytes((good / name).read_bytes())
    words = words_of(rng)
    # Errors of the library name an option as it is called there.
    names = [word.strip("-").replace("-", "_") for word in words if len(word) > 1]
    return Case(tuple(words), WRITTEN, (*names, "params.yaml", "view '", "name '", "lights: "))
