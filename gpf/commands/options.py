"""The arguments and options of the command `gpf`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from typer import Argument, Option

# What several commands have.

Scene = Annotated[
    str,
    Argument(
        metavar="SCENE",
        help="A scene file (.xml, .blend, .glb, .usd, .fbx, .obj), a folder with one, or the name "
        "of a scene in results/.",
    ),
]
Field = Annotated[
    str | None,
    Argument(
        metavar="FIELD",
        help="A field's file, or the name of a trained scene. [default: field.safetensors]",
    ),
]
FieldOfScene = Annotated[
    str | None,
    Option("--field", metavar="FIELD", help="The scene's field. [default: field.safetensors]"),
]
Groups = Annotated[
    str,
    Option(
        metavar="auto|FILE",
        help="Keep the light of emitters apart, to dim and colour it later: of each one, or of "
        "the groups in a YAML file such as `window: [sky]`.",
    ),
]
ChangedScene = Annotated[
    bool, Option("--changed-scene", help="Render even if the scene changed since the fit.")
]
Views = Annotated[
    Path | None,
    Option(
        metavar="FILE",
        help="The scene's cameras: views.yaml or transforms.json. [default: views.yaml beside the "
        "scene; without it, the scene's own, or for a fit others around them]",
    ),
]
Exposure = Annotated[
    float | None,
    Option(help="Exposure of PNG files, splats and colours. [default: from views.yaml or the fit]"),
]
Seed = Annotated[int, Option(min=0, help="Random seed.")]
Overwrite = Annotated[bool, Option("--overwrite", help="Replace what exists.")]

# `gpf convert`.

ForeignFile = Annotated[Path, Argument(metavar="FILE", help="A file that Blender reads.")]
SceneFolder = Annotated[
    Path | None,
    Option("--output", "-o", metavar="FOLDER", help="A new folder. [default: FILE without suffix]"),
]
ConvertedFrames = Annotated[
    str | None,
    Option(
        "--frames",
        metavar="all|FIRST:LAST",
        help="Write an animation, a scene file for each frame: all, or FIRST to LAST-1, from 0.",
    ),
]

# `gpf blender-addon`.

AddOn = Annotated[Path, Option("--output", "-o", metavar="FILE.zip", help="A new file.")]

# `gpf cache`.

Clear = Annotated[
    Literal["scenes", "all"] | None,
    Option(help="Remove the converted scenes, or all: also Blender and three.js."),
]

# `gpf demo` and `gpf export`.

NewFolder = Annotated[Path, Argument(help="A new folder.")]
Splats = Annotated[
    Path | None, Option(metavar="OUT.ply", help="Write splats, for viewers of 3D Gaussian splats.")
]
CompactField = Annotated[
    Path | None, Option(metavar="OUT.safetensors", help="Write a field of a third of the size.")
]

# `gpf bake`.

BakeFolder = Annotated[Path, Option("--output", "-o", metavar="FOLDER", help="A folder.")]
MapSize = Annotated[
    int | None,
    Option(metavar="N", min=16, max=16384, help="Maps of NxN texels. [default: 1024]"),
]
TexelsPerUnit = Annotated[
    float | None, Option(metavar="N", help="Texels per unit of length, instead of --size.")
]
VertexColours = Annotated[
    bool, Option("--vertex-colours", help="Light at the vertices of meshes instead of maps.")
]
BakeSpp = Annotated[
    int,
    Option(
        min=1,
        max=1_000_000,
        help="Samples per texel of the lamps whose direct light the field leaves out.",
    ),
]

SceneGlb = Annotated[
    Path | None,
    Option("--glb", metavar="FILE.glb", help="Write the scene in this light as glTF as well."),
]
ScenePage = Annotated[
    Path | None,
    Option(
        "--html",
        metavar="FILE.html",
        help="Write a page as well that shows the scene, without network: turn it, dim its lamps.",
    ),
]
Three = Annotated[
    Path | None,
    Option(
        "--three",
        metavar="FOLDER",
        help="three.js for the page, as npm has it, where it cannot be downloaded.",
    ),
]
SceneBlend = Annotated[
    Path | None,
    Option(
        "--blend",
        metavar="FILE.blend",
        help="Write a .blend file as well, with the light as images on the materials.",
    ),
]

# `gpf fit`.

NewField = Annotated[
    Path | None,
    Option(
        "--output",
        "-o",
        metavar="OUT.safetensors",
        help="The field's file. [default: field.safetensors]",
    ),
]
FitSeconds = Annotated[
    float | None, Option(help="Time limit of the fit, or of each frame [default there: 10].")
]
FittedFrames = Annotated[
    str | None,
    Option(
        "--frames",
        metavar="all|FIRST:LAST",
        help="Frames of an animation: all, or FIRST to LAST-1, from 0. SCENE is a folder of scene "
        "files with numbers in their names, a scene file with $frame in names of files, or a file "
        "that Blender reads; OUT is a folder. [default: fields]",
    ),
]
TargetPsnr = Annotated[
    float | None, Option(metavar="DB", help="Stop at this estimated PSNR of the images.")
]
Passes = Annotated[int | None, Option(help="Photon passes. [default without other goals: 300]")]
FinishedField = Annotated[
    Path | None,
    Option(
        "--continue",
        metavar="FIELD.safetensors",
        help="Continue a finished fit with more photons; replaces the field.",
    ),
]

# `gpf render`.

ViewNames = Annotated[
    list[str] | None, Option(metavar="NAME", help="A camera by name. Repeat it for several.")
]
Frames = Annotated[
    str | None,
    Option(
        metavar="all|FIRST:LAST",
        help="Frames: all, or FIRST to LAST-1, from 0. Of an animation if there is a folder "
        "with a field for each [default: fields]; else of the camera path in views.yaml.",
    ),
]
Orbit = Annotated[
    int,
    Option(metavar="N", min=0, max=100_000, help="N cameras around what the scene's camera sees."),
]
PictureFolder = Annotated[
    Path | None, Option("--output", "-o", metavar="FOLDER", help="[default: pictures]")
]
Size = Annotated[
    str | None, Option(metavar="WxH", help="Such as 512x512, or the rows alone. [default: 256]")
]
Spp = Annotated[
    int | None, Option(min=1, max=1_000_000, help="Camera samples per pixel. [default: 64]")
]
PictureSeconds = Annotated[float | None, Option(help="Time for each picture, instead of --spp.")]
Aovs = Annotated[
    str,
    Option(
        metavar="LIST",
        help="More layers, separated by commas: depth, position, normal, albedo, "
        "visible_normal, irradiance, coverage, error.",
    ),
]
Denoise = Annotated[
    bool | None,
    Option(
        "--denoise/--no-denoise",
        help="Use Open Image Denoise where noise is visible. [default: if pyoidn is installed]",
    ),
]
Gather = Annotated[
    Literal["auto", "never", "always"],
    Option(
        help="auto: with --denoise, correct pictures by light that is gathered where the camera "
        "looks, by samples of the lamps and rays that end in the field; always: all but caustics "
        "is gathered."
    ),
]
Film = Annotated[bool, Option("--mp4", help="Also write all pictures as a film.")]
Executor = Annotated[
    Literal["local", "ray"],
    Option(
        help="ray: spread pictures, or the frames of a fit, over the machines of a cluster. The "
        "fields then depend on how many there are."
    ),
]
Cluster = Annotated[
    str, Option(metavar="HOST:PORT", help="A Ray cluster. [default: start one on this machine]")
]
Levels = Annotated[
    str,
    Option(
        metavar="LEVELS",
        help="Brightness of a field's groups of lights: `window=0.2,lamp=1.5,#ffd0a0`.",
    ),
]

# `gpf view`.

ShownField = Annotated[
    str | None,
    Option(
        "--field",
        metavar="FIELD",
        help="A field's file. [default: --output if it exists; else one is fitted meanwhile]",
    ),
]
FittedField = Annotated[
    Path, Option("--output", "-o", metavar="OUT.safetensors", help="Where to save that field.")
]
JumpViews = Annotated[
    Path | None,
    Option(
        metavar="FILE",
        help="Cameras to jump to; new ones are saved there. [default: views.yaml "
        "beside the scene; saved in NAME.views.yaml]",
    ),
]
Host = Annotated[str, Option(help="Address to serve on; only this machine can reach the default.")]
Port = Annotated[int, Option(min=0, max=65535, help="Port to serve on; 0: any free one.")]
Opens = Annotated[bool, Option("--open/--no-open", help="Open the page in a browser.")]

# `gpf mitsuba`.

ImageFile = Annotated[
    Path | None, Option("--output", "-o", metavar="FILE", help="[default: the scene's name, .exr]")
]
Define = Annotated[
    list[str] | None,
    Option("--define", "-D", metavar="NAME=VALUE", help="A parameter of the scene."),
]
Sensor = Annotated[int, Option("--sensor", "-s", help="Index of the sensor.")]
SceneSpp = Annotated[
    int, Option(min=0, max=1_000_000, help="Samples per pixel; 0: as in the scene.")
]
MitsubaSeed = Annotated[int, Option(min=0, max=2**32 - 1, help="Random seed.")]
