"""Builds the swimming pool: its water, walls, floor, steps, deck, their textures and the sky.

The basin is |x| <= HALF_X, |z| <= HALF_Z, FLOOR <= y <= 0. Its parts are one-sided surfaces that
face the water. Each reaches ``OVERLAP`` behind its neighbour, so there are no slits. The water is a
height field whose edge reaches ``MARGIN`` into the walls. Walls and floor are opaque, so all light
below the water has passed its surface.

A tile is TILE wide on floor, walls and steps. All noise has fixed seeds: the builder writes the
same bytes every time.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from gpf.modelling.meshes import Mesh, box, grid, join, quad, write_ply
from gpf.modelling.textures import fractal_noise, ramp, write_png
from gpf.modelling.waves import GOLDEN, after, spread_waves, water_surface
from scenes.modelling.paving import planks, tiles
from scenes.modelling.sky import write_sky

HALF_X, HALF_Z, FLOOR = 1.5, 1.3, -1.1  # the basin; the deck is at y = 0
LEVEL = -0.13  # mean height of the water
CELLS_X, CELLS_Z = 256, 222  # 2 * 256 * 222 = 113,664 triangles
MARGIN = 0.001  # how far the water reaches into the walls
OVERLAP = 0.02  # how far a surface reaches behind its neighbour

TILE = 0.1
BAND_ROWS = 3  # rows of tiles below the deck that are a mosaic of half the size
RISE, RADII = 0.2, (0.45, 0.7, 0.95, 1.2)  # steps around the corner (-x, -z), from the top
PIXELS = 48  # width of a tile in the textures
FRAME = 3  # distance of the floor's dark tiles from its edge, in tiles
NOSING = 0.05  # width of the mosaic along a step's edge

# Bounds of the deck in x and z; the courtyard's two walls stand beyond WEST and NORTH.
WEST, EAST, NORTH, SOUTH = -1.86, 1.8, -1.66, 1.6
COPING = (0.18, 0.04, 0.015, 0.004)  # the stones' width, height and overhang; their open joints

# (wavelength, root-mean-square slope, number of directions). A crest with the curvature c focuses
# at the depth 4 / c (IOR 1.33); the water is about 0.97 deep.
BANDS = ((1.9, 0.025, 3), (0.85, 0.03, 5), (0.45, 0.042, 7), (0.25, 0.052, 9), (0.14, 0.014, 11))

# Display-referred colours; the sky has radiance by the sine of the elevation.
PALE = [(0.0, (0.42, 0.67, 0.73)), (0.5, (0.52, 0.75, 0.79)), (1.0, (0.62, 0.81, 0.83))]
DARK = [(0.0, (0.05, 0.22, 0.42)), (0.6, (0.10, 0.38, 0.58)), (1.0, (0.25, 0.60, 0.70))]
GROUT = (0.74, 0.78, 0.78)
WOOD = [(0.0, (0.48, 0.31, 0.20)), (0.5, (0.62, 0.42, 0.27)), (1.0, (0.74, 0.55, 0.38))]
JOINT = (0.20, 0.13, 0.09)
STONE = [(0.2, (0.78, 0.74, 0.67)), (0.8, (0.90, 0.87, 0.81))]
ORANGE, CREAM = (0.90, 0.50, 0.16), (0.90, 0.87, 0.80)
SKY = [(-0.15, (0.03, 0.03, 0.03)), (0.0, (0.18, 0.20, 0.22)), (1.0, (0.07, 0.12, 0.20))]


def water(seconds: float = 0) -> Mesh:
    """The surface of the water after some time; the scene has that of the first moment."""
    x = np.linspace(-HALF_X - MARGIN, HALF_X + MARGIN, CELLS_X + 1)
    z = np.linspace(HALF_Z + MARGIN, -HALF_Z - MARGIN, CELLS_Z + 1)
    return water_surface(after(spread_waves(BANDS), seconds), x, z, LEVEL)


def plane(corner: np.ndarray, right: np.ndarray, up: np.ndarray, origin: np.ndarray) -> Mesh:
    """A rectangle whose uv are the lengths from ``origin`` along ``right`` and ``up``."""
    mesh = quad(corner, right, up)
    axes = [np.asarray(a, dtype=float) / np.linalg.norm(a) for a in (right, up)]
    return replace(mesh, uv=np.stack([(mesh.points - origin) @ a for a in axes], axis=1))


def scaled(mesh: Mesh, width: float, height: float) -> Mesh:
    """The mesh with uv in units of an image of ``width`` by ``height``."""
    assert mesh.uv is not None
    return replace(mesh, uv=mesh.uv / [width, height])


def basin_walls() -> Mesh:
    """The four walls of the basin, facing the water; v = 0 at the floor, 1 at the deck."""
    sides = []
    for x, z in ((0, -1), (-1, 0), (0, 1), (1, 0)):
        out, right = np.array([x, 0, z], dtype=float), np.array([-z, 0, x], dtype=float)
        half = HALF_X if z else HALF_Z
        origin = out * (HALF_X if x else HALF_Z) - right * half + [0, FLOOR, 0]
        corner = origin - OVERLAP * (right + np.array([0, 1, 0]))
        size = right * 2 * (half + OVERLAP), np.array([0, 2 * OVERLAP - FLOOR, 0])
        sides.append(plane(corner, *size, origin))
    return scaled(join(sides), 20 * TILE, -FLOOR)


def basin_floor() -> Mesh:
    """The floor of the basin; uv from (0, 0) in the corner (-x, +z) to (1, 1)."""
    origin = np.array([-HALF_X, FLOOR, HALF_Z])
    right, up = np.array([2.0, 0, 0]), np.array([0, 0, -2.0])
    size = right * (HALF_X + OVERLAP), up * (HALF_Z + OVERLAP)
    corner = origin + OVERLAP * np.array([-1, 0, 1])
    return scaled(plane(corner, *size, origin), 2 * HALF_X, 2 * HALF_Z)


def steps(segments: int = 64) -> tuple[Mesh, Mesh]:
    """Quarter-round steps in the corner (-x, -z): treads with risers, and the mosaic edges.

    The treads' uv are lengths from the corner; the risers' u is the length along the arc.
    """
    centre = np.array([-HALF_X, 0, -HALF_Z])
    # The ends are a little behind the two walls.
    angle = np.linspace(-0.02, np.pi / 2 + 0.02, segments + 1)
    outwards = np.stack([np.sin(angle), np.zeros_like(angle), np.cos(angle)], axis=1)
    tiled, edges = [], []
    for i, radius in enumerate(RADII):
        y = -(i + 1.5) * RISE
        low = y - RISE if i + 1 < len(RADII) else FLOOR - OVERLAP
        inner = 0.0 if i == 0 else RADII[i - 1] - OVERLAP
        rings = (centre + r * outwards + [0, y, 0] for r in (inner, radius - NOSING, radius))
        inside, middle, outside = rings
        foot = outside + np.array([0, low - y, 0])
        arc = angle * radius
        tread = np.stack([middle, inside])
        tiled.append(grid(tread, uv=(tread - centre)[..., [0, 2]]))
        risen = np.stack([np.stack([arc, np.full_like(arc, h - y)], axis=1) for h in (low, y)])
        riser = grid(np.stack([foot, outside]), uv=risen)
        tiled.append(replace(riser, normals=np.tile(outwards, (2, 1))))
        across = np.stack([np.stack([arc, np.full_like(arc, h)], 1) for h in (0, NOSING)])
        edges.append(grid(np.stack([outside, middle]), uv=across))
    tiled[::2] = [replace(m, normals=np.tile([0.0, 1, 0], (len(m.points), 1))) for m in tiled[::2]]
    return scaled(join(tiled), 20 * TILE, 20 * TILE), scaled(join(edges), 20 * TILE, 20 * TILE)


def deck() -> Mesh:
    """The planks around the basin: four rectangles that end at the basin's walls, under the
    coping."""
    origin = np.array([WEST, 0, SOUTH])
    strips = [
        ((WEST, HALF_Z), (EAST, SOUTH)),
        ((WEST, NORTH - OVERLAP), (EAST, -HALF_Z)),
        ((WEST - OVERLAP, -HALF_Z), (-HALF_X, HALF_Z)),
        ((HALF_X, -HALF_Z), (EAST, HALF_Z)),
    ]
    made = [
        plane(np.array([x0, 0, z1]), np.array([x1 - x0, 0, 0]), np.array([0, 0, z0 - z1]), origin)
        for (x0, z0), (x1, z1) in strips
    ]
    return scaled(join(made), 2, 2)


def block() -> Mesh:
    """The block below the deck, facing outwards: four sides and the underside."""
    # The deck juts out a little, so that no light passes between the two.
    whole = box((WEST, FLOOR - 0.1, NORTH), (EAST - OVERLAP, 0, SOUTH - OVERLAP))
    top = (whole.points[whole.faces][:, :, 1] == 0).all(axis=1)
    return replace(whole, faces=whole.faces[~top])


def coping() -> Mesh:
    """Stones around the basin, with open joints; each has a different part of the noise texture."""
    width, height, overhang, joint = COPING
    x, z = HALF_X - overhang, HALF_Z - overhang
    runs = [  # (start, end) along one axis, and the two bounds along the other
        (0, (-x - width, x + width), (z, z + width)),
        (0, (-x - width, x + width), (-z - width, -z)),
        (2, (-z, z), (x, x + width)),
        (2, (-z, z), (-x - width, -x)),
    ]
    stones: list[Mesh] = []
    for axis, (start, end), (near, far) in runs:
        count = round((end - start) / 0.33)
        edges = np.linspace(start, end, count + 1)
        for a, b in zip(edges[:-1] + joint / 2, edges[1:] - joint / 2, strict=True):
            low, high = (a, near), (b, far)
            if axis == 2:
                low, high = (near, a), (far, b)
            # Sunk a little into the deck, so that no light passes underneath.
            stone = box((low[0], -0.001, low[1]), (high[0], height, high[1]))
            assert stone.uv is not None
            n = len(stones) + 1
            shift = np.array([n * GOLDEN % 1, n * n * GOLDEN % 1])
            stones.append(replace(stone, uv=stone.uv * [0.3, 0.2] + shift))
    return join(stones)


def basin_textures() -> dict[str, np.ndarray]:
    """Images of the basin's floor and walls, and of the tiles and the mosaic alone."""
    tiled = tiles(20, 20, PIXELS, PALE, GROUT, seed=1)
    mosaic = tiles(40, 40, PIXELS // 2, DARK, GROUT, seed=2)
    wall = tiled[: round(-FLOOR / TILE) * PIXELS].copy()
    wall[: BAND_ROWS * PIXELS] = mosaic[: BAND_ROWS * PIXELS]
    rows, columns = round(2 * HALF_Z / TILE), round(2 * HALF_X / TILE)
    floor = tiles(rows, columns, PIXELS, PALE, GROUT, seed=3)
    dark = tiles(rows, columns, PIXELS, DARK, GROUT, seed=4)
    row, column = np.mgrid[:rows, :columns]
    from_edge = np.minimum.reduce([row, column, rows - 1 - row, columns - 1 - column])
    frame = (from_edge == FRAME).repeat(PIXELS, axis=0).repeat(PIXELS, axis=1)
    floor[frame] = dark[frame]
    return {"floor": floor, "wall": wall, "tiles": tiled, "mosaic": mosaic}


def ball(gores: int = 8, pixels: int = 512) -> np.ndarray:
    """The ball's texture by longitude and latitude: gores of two colours, a cap at each pole."""
    longitude = (np.arange(pixels) + 0.5) / pixels * gores
    latitude = (np.arange(pixels // 2) + 0.5) / (pixels // 2)
    # Signed distances in pixels to the nearest seam and cap; edges are one pixel soft.
    seam = (0.5 - np.abs(longitude % 2 - 1)) * pixels / gores
    cap = (np.abs(latitude - 0.5) - 0.44) * pixels / 2
    share = np.clip(np.maximum(seam[None, :], cap[:, None]) + 0.5, 0, 1)[..., None]
    return share * np.array(ORANGE) + (1 - share) * np.array(CREAM)


def build(folder: Path) -> list[Path]:
    """Write ``meshes`` and ``textures`` below ``folder``; return the paths of their files."""
    treads, edges = steps()
    meshes = {
        "water": water(),
        "walls": basin_walls(),
        "floor": basin_floor(),
        "steps": treads,
        "nosing": edges,
        "coping": coping(),
        "deck": deck(),
        "block": block(),
    }
    images = basin_textures()
    images["ball"] = ball()
    images["planks"] = planks(20, 32, 1024, WOOD, JOINT, seed=5)
    images["stone"] = ramp(fractal_noise((256, 256), (12, 12), 4, seed=6), STONE)
    made = [write_ply(folder / f"meshes/{name}.ply", mesh) for name, mesh in meshes.items()]
    # v = 0 is a bitmap's first row.
    for name, image in images.items():
        made.append(write_png(folder / f"textures/{name}.png", image[::-1]))
    return [*made, write_sky(folder / "textures/sky.pfm", SKY)]
