"""Final gathering: the field inside an integrator of your own.

    python examples/own_integrator.py OUT --seconds 30

The integrator ``gpf`` queries the field at the first diffuse surface that a camera ray meets. This
one queries it one bounce later: it samples direct light, and one ray, in a direction chosen by the
BSDF, gathers the rest. Small shadows are thus as sharp as those of a path tracer, at the cost of
its noise. OUT receives a picture: this integrator on the left, Mitsuba's ``path`` on the right.
"""

from pathlib import Path

import gpf  # before mitsuba: it finds libLLVM

# ruff: isort: split
import drjit as dr
import mitsuba as mi
import numpy as np
import typer

from gpf.camera.visible_points import find_visible_points
from gpf.core.images import tone_map, write_png
from gpf.core.progress import say
from gpf.scene.lamps import Lamps

gpf.choose_variant("auto")  # the GPU if there is one, else the CPU


class FinalGathering(mi.ad.integrators.common.ADIntegrator):
    """Direct light by next event estimation, indirect light by one ray and the field."""

    field: gpf.GaussianPhotonField

    def sample(self, mode, scene, sampler, ray, depth=None, active=True, **kwargs):
        """Radiance of camera rays, (N, 3)."""
        # Go through mirrors and glass to a diffuse surface. The emission of a point is the light
        # that the ray meets on its way and, because of `lamps`, the direct light at its end. Light
        # through thin panes is left to the second ray.
        lamps = Lamps(scene, through_null=False)
        first, _ = find_visible_points(scene, sampler, ray, active=active, lamps=lamps)

        # A diffuse BSDF chooses directions in proportion to the cosine.
        direction = mi.warp.square_to_cosine_hemisphere(sampler.next_2d())
        origin = mi.Interaction3f(0, 0, ray.wavelengths, first.p, first.n)
        ray = origin.spawn_ray(mi.Frame3f(first.n).to_world(direction))

        # The light along that ray. Some fields leave the direct light of small lamps to us.
        lamps = self.field.settings.sampled_lamps(scene)
        second, _ = find_visible_points(scene, sampler, ray, active=first.valid, lamps=lamps)
        irradiance, _ = self.field.query(second.p, second.n, second.valid)
        light = self.field.reflect(second, irradiance)

        # A lamp that the ray meets first is already in the direct light.
        si = scene.ray_intersect(ray, active=first.valid)
        light -= si.emitter(scene).eval(si, first.valid)
        return first.radiance(dr.pi * light), first.valid, [], None


mi.register_integrator("final_gathering", lambda props: FinalGathering(props))


def main(folder: Path, seconds: float = 30, size: int = 256) -> None:
    """Write own_integrator.png into FOLDER."""
    folder.mkdir(parents=True, exist_ok=True)
    box, grey = mi.cornell_box(), {"type": "diffuse", "reflectance": 0.7}
    box["sensor"]["film"] |= {"width": size, "height": size, "rfilter": {"type": "box"}}
    box["small-box"] = {"type": "sphere", "center": [0.4, -0.65, 0.3], "radius": 0.35, "bsdf": grey}
    box["large-box"] = {
        "type": "sphere",
        "center": [-0.35, -0.5, -0.4],
        "radius": 0.5,
        "bsdf": grey,
    }
    scene = mi.load_dict(box, optimize=False)
    say(f"Fitting for {seconds:g} seconds.")
    integrator = mi.load_dict({"type": "final_gathering"})
    integrator.field = gpf.fit(scene, seconds=seconds)
    exposure = integrator.field.record["exposure"]
    ours = mi.render(scene, integrator=integrator, spp=256).numpy()
    path = mi.render(scene, integrator=mi.load_dict({"type": "path"}), spp=512).numpy()
    error = tone_map(ours, exposure) - tone_map(path, exposure)
    say(f"PSNR against the path tracer: {-10 * np.log10(np.mean(error**2)):.1f} dB")
    write_png(folder / "own_integrator.png", np.concatenate([ours, path], axis=1), exposure)


if __name__ == "__main__":
    typer.run(main)
