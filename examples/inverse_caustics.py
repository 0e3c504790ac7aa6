"""Inverse caustics: find a lens of glass whose caustic on a wall is a given picture.

    python examples/inverse_caustics.py OUT --seconds 60

A beam of parallel light goes through a plate of glass. Its front has heights h, and photon i, with
power Φ_i, arrives on the wall at x_i(h). The irradiance at the places y_j of a grid is

    E_j(h) = sum_i Φ_i K(y_j - x_i(h)),

with a smooth kernel K. Derivatives go through the places x_i: each photon's ray is intersected and
refracted again with heights that have derivatives. The loss compares E with the picture T,

    L(h) = sum_k |e_k|² / (1 + σ² |k|²),

where e_k are the cosine modes of E - T, scaled to the same total: the error is blurred before it is
squared. With a large σ, places that lack light attract photons from far away; while σ shrinks, L
becomes the plain sum of squares. OUT receives the lens as a mesh, the picture, and the caustic.
"""

import os
import time
from pathlib import Path

os.environ["OMP_NUM_THREADS"] = "1"  # NumPy's threads would wait where Dr.Jit's want to work

import gpf  # before mitsuba: it finds libLLVM

# ruff: isort: split
import drjit as dr
import mitsuba as mi
import numpy as np
import typer
from PIL import Image, ImageDraw, ImageFont
from scipy.fft import dctn, idctn
from scipy.ndimage import convolve1d
from scipy.optimize import minimize

from gpf.core.images import tone_map
from gpf.core.progress import progress_bar, say
from gpf.core.structs import from_numpy, to_numpy

gpf.choose_variant("auto")  # the GPU if there is one, else the CPU

GLASS = 1.5  # index of refraction
EDGE = 1.02  # half the width of the lens; that of the beam and of the picture is 1
WALL = 7.0  # distance of the wall from the lens
FRAME = 1.3  # half the width of the grid: light beside the picture is an error, too
SMOOTH = 0.2  # waves of the lens that are shorter than 2π times this are harder to change
SIGMAS = (0.5, 0.05, 0.005)


def draw_picture(size: int) -> np.ndarray:
    """The wanted irradiance, from 0 to 1, (H, W): letters in a ring, on grey ground."""
    k = 4 * size
    image = Image.new("L", (k, k), 20)
    pen, font = ImageDraw.Draw(image), ImageFont.load_default(0.38 * k)
    pen.ellipse([0.1 * k, 0.1 * k, 0.9 * k, 0.9 * k], outline=255, width=k // 16)
    pen.text((k / 2, 0.47 * k), "gpf", 255, font, anchor="mm", stroke_width=k // 80)
    return np.asarray(image.resize((size, size), Image.Resampling.LANCZOS)) / 255.0


def make_lens(heights: np.ndarray) -> mi.Mesh:
    """The front of the lens, with smooth normals; heights (n, n), rows along y."""
    n = len(heights)
    props = mi.Properties()
    props["glass"] = mi.load_dict({"type": "dielectric", "int_ior": GLASS, "ext_ior": 1.0})
    mesh = mi.Mesh("lens", n * n, 2 * (n - 1) ** 2, props, has_vertex_normals=True)
    params, index = mi.traverse(mesh), np.arange(n * n).reshape(n, n)
    a, b, c, d = (index[i : n - 1 + i, j : n - 1 + j] for i, j in np.ndindex(2, 2))
    params["faces"] = from_numpy(mi.UInt32, np.stack([a, b, c, b, d, c], axis=-1).ravel())
    y, x = np.meshgrid(*2 * [np.linspace(-EDGE, EDGE, n)], indexing="ij")
    places = np.stack([x, y, heights], axis=-1)
    params["vertex_positions"] = from_numpy(mi.Float, places.ravel())
    params.update()
    return mesh


def make_scene(size: int, heights: np.ndarray) -> mi.Scene:
    """Lamp, lens, wall, and between lens and wall a camera; light goes along z."""
    T, square = mi.ScalarTransform4f, {"type": "rectangle"}
    beam = {"type": "directionalarea", "radiance": {"type": "rgb", "value": 1.0}}
    glass = {"type": "dielectric", "int_ior": GLASS, "ext_ior": 1.0}
    back, wall = (T().translate([0, 0, z]).rotate([1, 0, 0], 180) for z in (-0.3, WALL))
    view = T().look_at(origin=[0, 0, WALL - 2.4], target=[0, 0, WALL], up=[0, -1, 0])
    film = {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}}
    angle = 2 * np.degrees(np.arctan(1 / 2.4))
    scene = {
        "type": "scene",
        "lamp": square | {"to_world": T().translate([0, 0, -2]), "emitter": beam},
        "back": square | {"to_world": back.scale(EDGE), "bsdf": glass},
        "lens": make_lens(heights),
        "wall": square | {"to_world": wall.scale(2)},
        "camera": {"type": "perspective", "fov": angle, "to_world": view, "film": film},
    }
    return mi.load_dict(scene, optimize=False)


def squares_of_waves(n: int, width: float) -> np.ndarray:
    """|k|² of the cosine modes of an (n, n) grid."""
    k = np.pi * np.arange(n) / width
    return k[:, None] ** 2 + k**2


class InverseCaustic:
    """Lens in, loss and gradient out.

    The unknowns u are cosine modes of the lens, h = C (u / (1 + SMOOTH² |k|²)): otherwise, L-BFGS
    would change short waves first.
    """

    def __init__(self, picture: np.ndarray) -> None:
        size = len(picture)
        self.n, self.photons, self.cell = size // 2 + 1, 2 * size**2, 2 / size
        framed = np.pad(picture, round(size * (FRAME - 1) / 2))
        # Blurred by the same kernel. Otherwise, the lens would sharpen its caustic beforehand.
        kernel = [1 / 8, 3 / 4, 1 / 8]
        self.wanted = convolve1d(convolve1d(framed, kernel, 0), kernel, 1)
        self.rows = len(self.wanted)
        through = (1 - ((GLASS - 1) / (GLASS + 1)) ** 2) ** 2  # two surfaces of a flat lens
        self.unit = picture.sum() / (4 * through)  # the picture's total for that of the beam
        self.scene = make_scene(size, np.zeros((self.n, self.n)))
        self.params = mi.traverse(self.scene)
        self.flat = mi.Point3f(dr.unravel(mi.Point3f, self.params["lens.vertex_positions"]))
        self.waves = squares_of_waves(self.rows, self.rows * self.cell)
        self.ease = 1 / (1 + SMOOTH**2 * squares_of_waves(self.n, 2 * EDGE))

    def heights(self, modes: np.ndarray) -> np.ndarray:
        """Heights, (n, n), of unknowns, (n²,)."""
        return idctn(self.ease * modes.reshape(self.n, self.n), norm="ortho")

    def trace(self, heights: mi.Float, seed: int) -> tuple[mi.Point2f, mi.Float, mi.Bool]:
        """Where photons arrive, (N, 2), and their power, both attached; whether they arrive.

        They leave the lamp on a lattice, which the seed shifts, and go through back and front of
        the lens. The power is that which Fresnel's equations let through; what is reflected is
        left out.
        """
        places = mi.Point3f(self.flat.x, self.flat.y, heights)
        self.params["lens.vertex_positions"] = dr.ravel(places)
        self.params.update()
        shift = np.random.default_rng(seed).integers(2**32, size=2)
        index, start = dr.arange(mi.UInt32, self.photons), mi.Point2f()
        for axis, step in enumerate((3242174889, 2447445414)):  # a lattice of low discrepancy
            number = index * step + dr.opaque(mi.UInt32, int(shift[axis]))
            start[axis] = mi.Float(number >> 8) * 2**-24
        ray, weight, _ = self.scene.sample_emitter_ray(0, 0.5, start, start, True)
        power, valid = weight.x / self.photons, mi.Bool(True)
        for _ in range(2):
            si = self.scene.ray_intersect(ray, mi.RayFlags.All, coherent=False, active=valid)
            valid &= si.is_valid()
            wi = si.to_local(-ray.d)
            reflected, cosine, _, eta = mi.fresnel(wi.z, GLASS)
            power *= 1 - reflected
            ray = si.spawn_ray(si.to_world(mi.refract(wi, cosine, eta)))
        si = self.scene.ray_intersect(ray, mi.RayFlags.All, coherent=False, active=valid)
        return mi.Point2f(si.p.x, si.p.y), power, valid & si.is_valid()

    def collect(self, heights: mi.Float, seed: int) -> mi.Float:
        """Power in the cells of the grid, (rows²,). The kernel is a quadratic B-spline."""
        place, power, valid = self.trace(heights, seed)
        place = place / self.cell + (self.rows - 1) / 2
        middle = dr.round(dr.detach(place))
        t = place - middle
        shares = [dr.square(0.5 - t) / 2, 0.75 - dr.square(t), dr.square(0.5 + t) / 2]
        cells = dr.zeros(mi.Float, self.rows**2)
        for i, j in np.ndindex(3, 3):
            y, x = mi.Int32(middle.y) + i - 1, mi.Int32(middle.x) + j - 1
            inside = valid & (y >= 0) & (y < self.rows) & (x >= 0) & (x < self.rows)
            share = power * shares[i].y * shares[j].x
            dr.scatter_add(cells, share, mi.UInt32(y * self.rows + x), inside)
        return cells

    def loss(self, modes: np.ndarray, sigma: float, seed: int) -> tuple[float, np.ndarray]:
        """L of unknowns, (n²,), and its gradient. The same seed means the same photons."""
        heights = from_numpy(mi.Float, self.heights(modes).ravel())
        dr.enable_grad(heights)
        power = self.collect(heights, seed)
        error = self.unit * to_numpy(power).reshape(self.wanted.shape) - self.wanted
        error = dctn(error, norm="ortho")
        blurred = error / (1 + sigma**2 * self.waves)
        slope = 2 * self.unit * idctn(blurred, norm="ortho")
        dr.backward(dr.sum(power * from_numpy(mi.Float, slope.ravel())))
        gradient = to_numpy(dr.grad(heights)).astype(float).reshape(self.n, self.n)
        return float(np.sum(error * blurred)), (self.ease * dctn(gradient, norm="ortho")).ravel()


def search(problem: InverseCaustic, seconds: float) -> np.ndarray:
    """Heights, (n, n), by L-BFGS. Each σ has a part of the time, and photons of its own."""
    modes = np.zeros(problem.n**2)
    problem.loss(modes, SIGMAS[0], 0)  # compiles the kernels
    options = {"maxcor": 20, "maxiter": 10**6, "maxfun": 10**6}
    begin = time.monotonic()
    with progress_bar("searching", 100) as bar:

        def look_at_the_clock(_: np.ndarray) -> None:
            passed = (time.monotonic() - begin) / seconds
            bar(min(100, round(100 * passed)))
            if passed > (seed + 1) / len(SIGMAS):
                raise StopIteration

        for seed, sigma in enumerate(SIGMAS):
            given = {"args": (sigma, seed), "jac": True, "options": options}
            found = minimize(
                problem.loss, modes, method="L-BFGS-B", callback=look_at_the_clock, **given
            )
            modes = found.x
            bar.describe(f"searching, σ {sigma:g}, loss {found.fun:.4g}")
    return problem.heights(modes)


def main(folder: Path, seconds: float = 60, size: int = 256) -> None:
    """Write lens.ply, and as PNG the picture, the caustics at start and end, and the heights."""
    folder.mkdir(parents=True, exist_ok=True)
    picture, problem = draw_picture(size), InverseCaustic(draw_picture(2 * size))
    lenses = {"flat": np.zeros((problem.n, problem.n)), "found": search(problem, seconds)}
    shown = {"picture": picture}
    for lens, heights in lenses.items():
        scene = make_scene(size, heights)
        # Mitsuba's own tracer of particles is an independent judge.
        particles = mi.load_dict({"type": "ptracer", "max_depth": 4})
        photons = {"type": "sppm", "photons_per_pass": 200_000, "initial_radius": 2 / size}
        for judge, integrator, spp in (
            ("ptracer", particles, 512),
            ("sppm", mi.load_dict(photons), 64),
        ):
            image = np.array(mi.render(scene, integrator=integrator, spp=spp))[..., 1]
            shown[lens] = image * picture.sum() / image.sum()
            psnr = -10 * np.log10(np.mean((shown[lens] - picture) ** 2) / picture.max() ** 2)
            same = np.corrcoef(image.ravel(), picture.ravel())[0, 1]
            say(f"{lens} lens, {judge}: correlation {same:.4f}, PSNR {psnr:.1f} dB")
    make_lens(heights).write_ply(str(folder / "lens.ply"))
    panels = {name: np.round(255 * tone_map(image, 1)) for name, image in shown.items()}
    relief = Image.fromarray(255 * (heights - heights.min()) / np.ptp(heights))
    panels["heights"] = np.round(relief.resize((size, size)))
    a, b, c, d = panels.values()
    panels["inverse_caustics"] = np.vstack([np.hstack([a, b]), np.hstack([c, d])])
    for name, panel in panels.items():
        Image.fromarray(panel.astype(np.uint8)).save(folder / f"{name}.png")


if __name__ == "__main__":
    typer.run(main)
