"""Every Cycles setting that alters pixels, with its value and the reason, and their only setter.

Blender accepts `scene.cycles.<typo> = x` without an error, and clamps a value outside a property's
range; `assign` refuses both. A setting is named by its path from the scene: `cycles.samples`,
`render.film_transparent`, `world.cycles.sampling_method`.
"""

import contextlib
import difflib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Setting:
    """One property of a Blender scene by its path, its value, and the reason for the value."""

    path: str
    value: object
    reason: str


ALWAYS = (
    Setting("render.engine", "CYCLES", "the renderer that the closed forms describe"),
    Setting("render.resolution_percentage", 100, "sizes are in whole pixels"),
    Setting("render.pixel_aspect_x", 1.0, "square pixels"),
    Setting("render.pixel_aspect_y", 1.0, "square pixels"),
    Setting(
        "render.film_transparent", True, "the background is black and never part of the picture"
    ),
    Setting(
        "render.use_persistent_data",
        True,
        "the next view, light or material of a shape needs no new scene",
    ),
    Setting("render.use_compositing", False, "nothing alters the rendered pixels"),
    Setting("render.use_sequencer", False, "nothing alters the rendered pixels"),
    Setting("render.use_motion_blur", False, "nothing moves"),
    Setting("render.use_simplify", False, "shapes as they are"),
    Setting("render.dither_intensity", 0.0, "the default 1 adds noise"),
    Setting(
        "view_settings.view_transform",
        "Raw",
        "the default AgX is no radiance; pixels are read before it, this is a second lock",
    ),
    Setting("view_settings.exposure", 0.0, "radiance as it is"),
    Setting("view_settings.gamma", 1.0, "radiance as it is"),
    Setting("cycles.shading_system", False, "SVM: the closed forms are its closures"),
    Setting("cycles.feature_set", "SUPPORTED", "no experimental feature"),
    Setting("cycles.use_animated_seed", False, "seeds come from the job"),
    Setting("cycles.sample_offset", 0, "all samples of the sequence"),
    Setting("cycles.use_sample_subset", False, "all samples of the sequence"),
    Setting("cycles.time_limit", 0.0, "samples decide, never the clock"),
    Setting(
        "cycles.use_adaptive_sampling",
        False,
        "the default stops early where noise seems low: a bias",
    ),
    Setting(
        "cycles.use_denoising", False, "the default paints over noise: a bias, and it needs 0.4 s"
    ),
    Setting(
        "cycles.sampling_pattern",
        "TABULATED_SOBOL",
        "AUTOMATIC may dither seeds between pixels; noise must be independent",
    ),
    Setting("cycles.scrambling_distance", 1.0, "no correlation between pixels"),
    Setting("cycles.auto_scrambling_distance", False, "no correlation between pixels"),
    Setting(
        "cycles.use_light_tree",
        False,
        "one light, the world: a tree over the mesh costs 5 ms a view and finds nothing",
    ),
    Setting(
        "cycles.light_sampling_threshold",
        0.0,
        "the default .01 drops dim light by chance: noise for nothing",
    ),
    Setting(
        "cycles.direct_light_sampling_type",
        "MULTIPLE_IMPORTANCE_SAMPLING",
        "narrow lobes and small suns both",
    ),
    Setting("cycles.use_guiding", False, "learns while it renders: results depend on order"),
    Setting("cycles.sample_clamp_direct", 0.0, "clamping removes energy"),
    Setting("cycles.sample_clamp_indirect", 0.0, "the default 10 removes energy"),
    Setting("cycles.blur_glossy", 0.0, "the default 1 widens lobes after the first bounce"),
    Setting(
        "cycles.caustics_reflective", True, "metal lights its neighbour: that is interreflection"
    ),
    Setting("cycles.caustics_refractive", False, "nothing transmits"),
    Setting("cycles.use_fast_gi", False, "interreflection is traced"),
    Setting("cycles.transmission_bounces", 0, "nothing transmits"),
    Setting("cycles.volume_bounces", 0, "no volumes"),
    Setting("cycles.transparent_max_bounces", 0, "nothing is transparent"),
    Setting("cycles.min_light_bounces", 0, "Russian roulette from the first bounce: unbiased"),
    Setting("cycles.film_exposure", 1.0, "radiance as it is"),
    Setting("cycles.use_auto_tile", False, "one tile: no seams, no files on disk between"),
    Setting("cycles.texture_limit_render", "OFF", "light maps as they are"),
    Setting(
        "cycles.debug_use_spatial_splits", False, "building costs more than it saves at these sizes"
    ),
)

# by manifests.schema.Camera.pixel; "centre" is no BOX, because Cycles ignores the width of one
PIXELS = {
    "square": (
        Setting(
            "cycles.pixel_filter_type",
            "BOX",
            "a pixel is the mean over its own square, as a camera's is",
        ),
        Setting("cycles.filter_width", 1.0, "the default 1.5 reaches into neighbours"),
    ),
    "centre": (
        Setting(
            "cycles.pixel_filter_type",
            "GAUSSIAN",
            "a pixel is the point that geometry holds: what the layer sees",
        ),
        Setting("cycles.filter_width", 0.01, "the least that Cycles takes"),
    ),
}
PICTURE = PIXELS["square"]

# for pictures to an error that a job asks for (factory.render.estimators)
WHOLE_SEQUENCE = 8192  # the longest that Cycles tabulates
PORTION = (
    Setting(
        "cycles.samples", WHOLE_SEQUENCE, "each portion is a part of one and the same sequence"
    ),
    Setting("cycles.use_sample_subset", True, "a picture grows until its error is kept"),
)
# passes of a layer besides the picture: those that guide the denoiser, and indirect light
PASSES = (
    "cycles.denoising_store_passes",
    "use_pass_normal",
    "use_pass_diffuse_color",
    "use_pass_glossy_color",
    "use_pass_diffuse_indirect",
    "use_pass_glossy_indirect",
)
DENOISED = (
    Setting("cycles.denoiser", "OPENIMAGEDENOISE", "the same on every machine"),
    Setting("cycles.denoising_input_passes", "RGB_ALBEDO_NORMAL", "guides keep edges"),
    Setting("cycles.denoising_use_gpu", False, "the same on every machine"),
)

GEOMETRY = (
    Setting("cycles.pixel_filter_type", "BOX", "with the least width"),
    Setting(
        "cycles.filter_width",
        0.01,
        "a ray through the pixel's centre; Cycles sends the first sample there whatever the width,"
        " this is a second lock",
    ),
    Setting("cycles.samples", 1, "un-antialiased: more would average normals, depths and segments"),
    Setting(
        "cycles.seed",
        0,
        "nothing is drawn by lot: the first sample goes through the pixel's centre",
    ),
)

# The light transport of each tier. Without `unoccluded` the object blocks light: the studio sets
# its `visible_*` properties accordingly.
TIERS: dict[str, dict[str, Any]] = {
    "direct": {
        "unoccluded": True,
        "bounces": 0,
        "reason": "what the layer computes: neither shadow nor interreflection",
    },
    "shadow": {"unoccluded": False, "bounces": 0, "reason": "the object shades itself"},
    "full": {
        "unoccluded": False,
        "bounces": 6,
        "reason": (
            "and lights itself: on a chair of albedo .8 deeper bounces carry 1e-4 of the light"
        ),
    },
}


def _owner(root: Any, path: str) -> tuple[Any, str]:
    """Return the object that has the property at a path, and the property's name."""
    *owners, name = path.split(".")
    for step in owners:
        root = getattr(root, step)
    return root, name


def assign(root: Any, path: str, value: Any) -> Any:
    """Set one property, read it back, and return the value that Blender holds.

    root    a Blender object, mostly a scene
    path    dotted, from root
    Raises  AttributeError for an unknown property; ValueError for a value that Blender refuses
    """
    owner, name = _owner(root, path)
    known = owner.bl_rna.properties
    if name not in known:
        near = difflib.get_close_matches(name, known.keys(), n=3)
        raise AttributeError(
            f"{type(owner).__name__}.{name}: expected a property of this Blender, found none of"
            f" this name (did you mean {', '.join(near) or 'nothing near'}?)"
        )
    try:
        setattr(owner, name, value)
    except TypeError as error:  # an enum item or a type that Blender does not have
        raise ValueError(f"{path}: {value!r} is not accepted; {error}") from None
    held = getattr(owner, name)
    same = (
        abs(held - value) <= 1e-6 * max(1.0, abs(value))
        if isinstance(value, float)
        else held == value
    )
    if not same:
        raise ValueError(
            f"{path}: expected {value!r}, found that Blender holds {held!r} (the value lies outside"
            " the property's range)"
        )
    return held


def apply(root: Any, settings: Iterable[Setting]) -> None:
    """Apply each Setting to a scene."""
    for setting in settings:
        assign(root, setting.path, setting.value)


def effective(root: Any, settings: Iterable[Setting]) -> dict[str, dict[str, Any]]:
    """Return {path: {"value", "reason"}} with the values that Blender holds, for dataset.json."""

    def held(path: str) -> Any:
        owner, name = _owner(root, path)
        value = getattr(owner, name)
        return round(value, 6) if isinstance(value, float) else value

    return {s.path: {"value": held(s.path), "reason": s.reason} for s in settings}


@contextlib.contextmanager
def portion_of_samples(scene: Any, first: int, count: int, seed: int) -> Iterator[None]:
    """Render samples first … first + count − 1 of a seed's sequence inside the block.

    What guides the denoiser is among the passes, which changes no pixel.
    """
    layer = scene.view_layers[0]
    earlier = {s.path: scene.path_resolve(s.path) for s in PORTION}
    try:
        apply(scene, PORTION)
        assign(scene, "cycles.sample_offset", int(first))
        assign(scene, "cycles.sample_subset_length", int(count))
        assign(scene, "cycles.seed", int(seed) & 0x7FFFFFFF)
        for each in PASSES:
            assign(layer, each, True)
        yield
    finally:
        for path, value in earlier.items():
            assign(scene, path, value)
        assign(scene, "cycles.sample_offset", 0)
        for each in PASSES:
            assign(layer, each, False)
