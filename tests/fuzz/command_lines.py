"""Command lines: options that are missing, doubled, or have values that nobody expects."""

from __future__ import annotations

import json

from hypothesis import strategies as st

from tests.fuzz import odd
from tests.fuzz.case import Case, Files
from tests.fuzz.good import FIRST, SCENE, TRANSFORMS, VIEWS, good_fields
from tests.fuzz.pipeline import params

# Words, by what they may stand for.
NUMBERS = "1 0 -1 3 0.5 nan inf -inf 1e-9 1e30 1e400 2147483648 18446744073709551616 x 1_000 ٣ "
NUMBERS += f"0x10 1e3 {'9' * 40} {'9' * 5000}"
FILES = "scene.xml field.safetensors views.yaml transforms.json . missing bytes /dev/null folder"
FILES += " folder/x.safetensors scene.xml/x"
OUTPUTS = "out out.exr out.PNG out.jpg out.xyz out.ply out.PLY out.safetensors"
VALUES = {
    **dict.fromkeys(["FIELD", "--field", "--continue"], f"field.safetensors {FILES}"),
    **dict.fromkeys(["--output", "--ply", "--compact"], f"{OUTPUTS} {FILES}"),
    **dict.fromkeys(["--spp", "--seed", "--exposure", "--sensor", "--texels-per-unit"], NUMBERS),
    **dict.fromkeys(["--seconds", "--target-psnr"], "1 0.1 nan -1 0 1e-9 -inf"),
    **dict.fromkeys(["--executor", "--cluster", "--method", "--variant"], "local x all path_10"),
    **dict.fromkeys(
        ["--no-denoise", "--mp4", "--changed-scene", "--go-on", "--vertex-colours"], ""
    ),
    "--views": f"views.yaml transforms.json {FILES}",
    "--view": "eye x",
    "--frames": "all 0:1 : 1:0 x",
    "--passes": f"0:1 x 1:0 : -1:2 {'9' * 5000}:1",
    "--orbit": f"2 0 -1 x 1000000000 {'9' * 40}",
    "--size": "5x4 4 0x0 x 5x4x3 -4 1e3 99999x9 16384x16384",
    "--aovs": "depth depth,depth error,coverage , x Depth",
    "--gather": "never always x",
    "--lights": "lamp=0.5 lamp=nan lamp = sky=1,#ffd0a0 #zz sky=1e400",
    "--groups": f"auto {FILES}",
    "--host": f"127.0.0.1 localhost x 999.9.9.9 1.2.3.4 ::1 {'a' * 300}",
    "--port": "0 80 -1 65535 99999 x",
    "--define": "spp=2 x = filename=x config=1",
    "--name": f"room first .. true {'x' * 300}",
    "--scene": "first second ../first .",
}
# Command lines that work, and options that may follow them.
COMMANDS = {
    "render scene.xml --size 5x4 --spp 1": "--field --view --views --frames --orbit --output --size"
    " --spp --seconds --aovs --exposure --no-denoise --mp4 --seed --changed-scene --executor"
    " --cluster --lights --gather",
    "fit scene.xml --passes 2": "--output --seconds --target-psnr --views --seed --continue"
    " --groups",
    "view scene.xml --no-open --field field.safetensors": "--output --views --host --port --groups"
    " --changed-scene",
    "mitsuba scene.xml --spp 1": "--output --define --sensor --spp --seed",
    "export field.safetensors": "--ply --compact --exposure",
    "info": "FIELD",
    "bake scene.xml --size 128 --spp 1": "--field --output --size --texels-per-unit"
    " --vertex-colours --spp --exposure --seed --changed-scene",
    "demo scenes": "",
    "profile smoke": "",
    "scene list": "",
    "scene import scenes/first": "--name",
    "scene preview second": "--name",
    "stage scene": "--scene",
    "stage reference --scene first": "--passes",
    "stage baseline --scene first": "--method --go-on",
    "stage ablation --scene first": "--variant --go-on",
}
WRITTEN = (
    "out out/* out.* baked baked/* gpf-demo/* pictures/* scenes/room/* results/* folder/* missing "
)
WRITTEN += (
    "missing/* bytes/* params.yaml scene.exr scene.xml field.safetensors field.png field.fit/* "
)
WRITTEN += "right.* orbit* transforms.json"  # with `--output .`


def words_of(draw: st.DrawFn) -> list[str]:
    """A command line; some of its words may be wrong."""
    command = draw(st.sampled_from([*COMMANDS, *[*COMMANDS][:5], *[*COMMANDS][:2]]))
    options = COMMANDS[command].split()
    words = command.split()
    for _ in range(draw(st.integers(0, 3)) if options else 0):
        option = draw(st.sampled_from(options))
        words += [option] if option.startswith("-") else []
        if VALUES[option]:
            values = odd.TEXTS if odd.rarely(draw, 10) else st.sampled_from(VALUES[option].split())
            words.append(draw(values))
    if odd.rarely(draw, 7):
        at = draw(st.integers(0, len(words) - 1))
        odd_word = draw(st.sampled_from(["", "--"])) + draw(odd.TEXTS)
        words[at : at + 1] = draw(st.sampled_from([[], [words[at]] * 2, [odd_word]]))
    return words


@st.composite
def cases(draw: st.DrawFn) -> Case:
    """A command line in a folder of good files."""
    scene = SCENE.replace("<sensor", '<integrator type="path"/><sensor', 1)
    texts = {"scene.xml": scene, "views.yaml": VIEWS, "params.yaml": params()}
    texts["transforms.json"] = json.dumps(TRANSFORMS)
    files: Files = {**FIRST, **{name: text.encode() for name, text in texts.items()}}
    files |= {"folder": None, "bytes": bytes(100), "field.safetensors": good_fields()["plain"]}
    words = words_of(draw)
    # Errors of the library name an option as it is called there.
    names = [word.strip("-").replace("-", "_") for word in words if len(word) > 1]
    names += [f"error: {word.strip() or '.'}: " for word in words]
    names += ["-D ", "params.yaml", "error: field.safetensors: ", "view '", "name '", "lights: "]
    return Case(tuple(words), tuple(WRITTEN.split()), tuple(names), files)
