"""A web page to edit a photograph in, as one file that needs neither a server nor a network.

The page holds the photograph, its object's normals and coverage, and the reflectance maps of every
material under some lights (learn.editing.reflectance_store). A shader looks radiance up by normal
and composes the picture as learn.editing.compositor does; without WebGL 2 the same is done in
JavaScript. Blends of two materials are exact, because radiance is linear in the BRDF.

The page differs from `learn edit` in these points:

- A photograph larger than LONGEST is reduced to that. One normal is looked up for each pixel, also
  where the compositor renders several and averages them, for objects under 256 pixels.
- The background behind the object is as bright as white at most.
- Under another light than the photograph's own the background remains as it is, or is hidden. The
  other lights have unit mean luminance and the photograph's exposure, and the photograph's fine
  shading, which belongs to its own light, is left out.
- The viewer is distant, as for all edits.

learn.editing.interactive_maps decides how fine the maps are, and learn.editing.chunks how data are
stored; the page holds all of them as base64.
"""

import base64
import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch
from PIL import Image
from scipy.ndimage import map_coordinates

from learn.data import framing
from learn.data import lights as light_maps
from learn.data.devices import to_numpy
from learn.editing import drawing, interactive_maps, material_list, reflectance_store, targets
from learn.editing.backgrounds import fill_from_nearest
from learn.editing.chunks import Chunks, differences, split_bytes
from learn.editing.compositor import Compositor
from learn.editing.photograph import CLEAR
from learn.editing.residual_shading import LARGEST
from learn.figures import html, montage, spheres
from manifests.errors import InputError
from manifests.progress import tqdm
from shaders import tone

if TYPE_CHECKING:
    from learn.editing.edit import EditOptions, EditResult

NAME = "interactive.html"
FOLDER = Path(__file__).parent / "interactive_page"
LONGEST = 1024  # pixels of the photograph's longer side
LARGEST_FILE = 15_000_000  # bytes
PART_SIDE = 160  # pixels of the pictures of the decomposition
# pixels at which a map is compared with the layer; highlights of sharp materials are a few pixels
CHECKED_PIXELS = 1024
# the same for the Scene of `make_scene`, whose maps the app renders while its user waits
CHECKED_NORMALS = 512
LIGHTS_HEADER = 60_000  # bytes that are kept free for the lights' part of the header
FINE_SIDES = tuple(side for side in reflectance_store.SIDES if side > reflectance_store.COARSE)
MEASURED = {
    "blender_city": "City square",
    "blender_sunset": "Sunset",
    "blender_interior": "Hotel interior",
}
MEASURED_FILE = Path(light_maps.__file__).parents[2] / "manifests" / "measured-lights" / "maps.npz"


def make_page(result: "EditResult", edit_options: "EditOptions") -> str:
    """Return the page of an EditResult, and show progress.

    Raises  InputError: it is larger than LARGEST_FILE
    """
    decomposed = result.decomposition
    compositor = Compositor(decomposed, edit_options.tolerance, edit_options.detail)
    chunks = Chunks()
    header = {
        "title": decomposed.photograph.name,
        "detail": edit_options.detail,
        "largestDetail": LARGEST,
        "stops": edit_options.stops,
        "regions": decomposed.photograph.count,
        "steps": reflectance_store.STEPS,
        "bend": reflectance_store.BEND,
    }
    picture, n = add_picture(compositor, chunks)
    header |= picture
    materials = material_list.list_materials(result)
    header["materials"] = [
        {key: value for key, value in material.items() if key != "label"} for material in materials
    ]
    header["chosen"] = material_list.chosen_materials(result, materials)
    read = [
        x for each in result.edits for x in targets.labels_from_pictures(each.text, each.labels)
    ]
    lights = lights_of(decomposed.parts.light)
    labels = [material["label"] for material in materials]
    maps = render_maps(compositor, labels, read, list(lights.values()), n)
    header["parts"] = [
        {
            "caption": caption,
            "picture": html.encode_picture(montage.fit_into_square(picture, PART_SIDE)),
        }
        for caption, picture in draw_decomposition(result)
    ]
    # four characters of base64 hold three bytes
    left = LARGEST_FILE - len(assemble(header, chunks).encode()) - LIGHTS_HEADER
    interactive_maps.reduce_maps([map_ for each in maps for map_ in each], left * 3 // 4)
    header["lights"] = [
        {"name": name} | interactive_maps.add_light_maps(each, L, chunks)
        for (name, L), each in zip(lights.items(), maps, strict=True)
    ]
    page = assemble(header, chunks)
    if len(page.encode()) > LARGEST_FILE:
        size = f"{len(page) / 1e6:.1f} MB"
        raise InputError(
            "--interactive",
            f"a page of at most {LARGEST_FILE / 1e6:g} MB",
            size,
            "reduce the photograph",
        )
    return page


def render_maps(
    compositor: Compositor,
    labels: Sequence[np.ndarray],
    read: Sequence[np.ndarray],
    lights: Sequence[torch.Tensor],
    n: np.ndarray,
) -> list[list[list[interactive_maps.TriedMap]]]:
    """Return for each light and each label the maps that were tried, and show progress.

    labels  (108,) each
    read    the labels that were read from pictures, as Compositor.mirror_correction takes them
    lights  (1, 3, Hl, Wl) each
    n       (N, 3) unit normals that the page looks up
    """
    nodes = {side: reflectance_store.nodes_read(n, side) for side in FINE_SIDES}
    maps: list[list[list[interactive_maps.TriedMap]]] = []
    with tqdm(total=len(labels) * len(lights), unit="map", desc="reflectance maps") as progress:
        for L in lights:
            scene = make_scene(compositor, L)._replace(
                checked=choose_normals(n, CHECKED_PIXELS),
                finest=reflectance_store.SIDES[-1],
                nodes=nodes,
                coded=True,
            )
            maps.append([])
            for label in labels:
                exposure = scene.exposure * compositor.mirror_correction(label, read)
                maps[-1].append(interactive_maps.try_maps(label, scene._replace(exposure=exposure)))
                progress.update()
    return maps


def add_picture(compositor: Compositor, chunks: Chunks) -> tuple[dict, np.ndarray]:
    """Add the picture's planes and the normals to the page's data.

    Return their header, and the unit normals (N, 3) that the page looks up.
    """
    decomposed = compositor.decomposition
    height, width = decomposed.photograph.mask.shape
    scale = min(1.0, LONGEST / max(height, width))
    size = max(1, round(height * scale)), max(1, round(width * scale))
    planes = picture_planes(compositor, size)
    n = to_numpy(decomposed.parts.n[0].movedim(0, -1))
    filled = fill_from_nearest(n, decomposed.framed.mask)
    normals = np.rint(filled.clip(-1, 1) * 32767).astype(np.int16).view(np.uint16)
    square = [float(x * scale) for x in decomposed.framed.box]
    header = {
        "height": size[0],
        "width": size[1],
        "box": square,
        "planes": [plane.shape[-1] for plane in planes],
        "pictureData": chunks.add(
            b"".join(differences(plane, 1).astype(np.uint8).tobytes() for plane in planes)
        ),
        "normalsSize": len(n),
        "normalsData": chunks.add(split_bytes(differences(normals, 2).ravel())),
    }
    covered = planes[2][..., 0] > 0
    return header, interpolate_normals(normals.view(np.int16), square, covered)


def picture_planes(compositor: Compositor, size: tuple[int, int]) -> list[np.ndarray]:
    """Return what the page composes a picture of, each (height, width, C) uint8, at `size`.

    They are the photograph, what is behind the object's soft edge minus the photograph, coverage,
    regions and residual shading. A photograph with transparency has two more: its opacity, and the
    object's share of each pixel's colour.
    """
    decomposed = compositor.decomposition
    opened, box = decomposed.photograph, decomposed.framed.box
    height, width = opened.mask.shape
    exposure = drawing.display_exposure(opened)

    def small(picture: np.ndarray) -> np.ndarray:
        return reduce_picture(montage.eight_bit(picture), size)

    frame = np.zeros((height, width), np.float32)
    coverage = framing.paste_square(frame, compositor.coverage, box)
    regions = framing.paste_square(frame.astype(np.uint8), compositor.filled_regions, box)
    share = compositor.share()
    cut = framing.cut_square(opened.radiance, box)
    soft = (share > 0) & (share < 1 - CLEAR)
    cut = np.where(soft[..., None], compositor.background(), cut).astype(np.float32)
    behind = small(tone.display(framing.paste_square(opened.radiance, cut, box), exposure))
    photo = small(tone.display(opened.radiance, exposure))
    residual = compositor.residual() / np.log(LARGEST)
    residual = framing.paste_square(
        np.full((height, width, 3), 127.5), (residual + 1).clip(0, 2) * 127.5, box
    )
    rows = np.minimum(((np.arange(size[0]) + 0.5) * height / size[0]).astype(int), height - 1)
    columns = np.minimum(((np.arange(size[1]) + 0.5) * width / size[1]).astype(int), width - 1)
    planes = [
        photo,
        behind - photo,  # modulo 256: 0 but along the edge
        small(255 * coverage[..., None]),
        regions[rows][:, columns][..., None],
        small(residual),
    ]
    if opened.opacity is not None:
        share = framing.paste_square(frame, share, box)
        planes += [small(255 * opened.opacity[..., None]), small(255 * share[..., None])]
    return planes


def interpolate_normals(codes: np.ndarray, box: Sequence[float], covered: np.ndarray) -> np.ndarray:
    """Return the unit normals (N, 3) that the page looks up at the pixels `covered` (H, W) bool.

    They are interpolated bilinearly, as page.js does it.

    codes  (n, n, 3) int16 normals at the network's size
    box    top, left and side of the object's square, in the page's pixels
    """
    top, left, side = box
    last = len(codes) - 1
    rows, columns = np.nonzero(covered)
    at = [(rows + 0.5 - top), (columns + 0.5 - left)]
    at = np.stack(at) * (len(codes) / side) - 0.5
    n = [map_coordinates(codes[..., k].astype(float), at.clip(0, last), order=1) for k in range(3)]
    result = np.stack(n, -1)
    return result / np.maximum(np.linalg.norm(result, axis=-1, keepdims=True), 1e-9)


def reduce_picture(picture: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Return a picture (H, W, C) uint8 averaged to a size (height, width)."""
    if picture.shape[:2] == size:
        return picture
    planes = [
        np.asarray(Image.fromarray(plane).resize(size[::-1], Image.Resampling.BOX))
        for plane in np.moveaxis(picture, -1, 0)
    ]
    return np.stack(planes, -1)


def make_scene(compositor: Compositor, light: torch.Tensor) -> reflectance_store.Scene:
    """Return the Scene of a light (1, 3, Hl, Wl); maps are compared at the object's normals."""
    decomposed = compositor.decomposition
    n = to_numpy(decomposed.parts.n[0].movedim(0, -1))[decomposed.framed.mask]
    return reflectance_store.Scene(
        light,
        decomposed.batch.elevation,
        drawing.display_exposure(decomposed.photograph) / decomposed.exposure,
        compositor.tolerance,
        choose_normals(n / np.linalg.norm(n, axis=-1, keepdims=True), CHECKED_NORMALS),
    )


def choose_normals(n: np.ndarray, count: int) -> np.ndarray:
    """Return `count` of unit normals (N, 3), drawn at random among those that face the viewer."""
    facing = n[n[:, 2] > 1e-2]
    return facing[np.random.default_rng(0).integers(len(facing), size=count)]


def lights_of(own: torch.Tensor) -> dict[str, torch.Tensor]:
    """Return {name: L (1, 3, Hl, Wl)}, the photograph's own light first."""
    measured = light_maps.read_maps(MEASURED_FILE)
    others = {"Studio window": spheres.preview_lighting()}
    others |= {name: measured[key] for key, name in MEASURED.items()}
    result = {"The photograph’s own": own}
    for name, L in others.items():
        mean, _ = light_maps.envmap.unit_mean(L)
        result[name] = torch.from_numpy(mean).movedim(-1, 0)[None].contiguous().to(own)
    return result


def draw_decomposition(result: "EditResult") -> list[tuple[str, np.ndarray]]:
    """Return captions and display pictures of the decomposition."""
    decomposed, opened = result.decomposition, result.decomposition.photograph
    n, L = (
        to_numpy(part[0].movedim(0, -1)) for part in (decomposed.parts.n, decomposed.parts.light)
    )
    rendering = drawing.on_ground(
        tone.display(result.rendering, drawing.display_exposure(opened)), opened
    )
    names = (
        ["material"] if opened.count == 1 else [f"material {s + 1}" for s in range(opened.count)]
    )
    return [
        (
            "normals: which way the surface faces",
            montage.normals_picture(n, decomposed.framed.mask),
        ),
        ("light: all directions, as a map", montage.light_picture(L)),
        *(
            (f"{name}, on a sphere", drawing.material_sphere(label, decomposed))
            for name, label in zip(names, decomposed.parts.label[0], strict=True)
        ),
        ("rendered again from these", rendering),
    ]


def assemble(header: dict, chunks: Chunks) -> str:
    """Return the page: its files and the data as one HTML text."""
    text = json.dumps(header, ensure_ascii=False, separators=(",", ":")).replace("<", "\\u003c")
    parts = {
        name: (FOLDER / name).read_text("utf-8") for name in ("page.css", "shader.glsl", "page.js")
    }
    parts |= {"header": text, "data": base64.b64encode(chunks.data).decode()}
    result = (FOLDER / "page.html").read_text("utf-8")
    for name, part in parts.items():
        result = result.replace("{{" + name + "}}", part, 1)
    return result
