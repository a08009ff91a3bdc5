"""Small datasets whose pictures are computed here instead of in Cycles: a sphere, known materials,
known light, known noise.
"""

import hashlib

import msgspec
import numpy as np
import torch

from learn.data.sources import VALIDATION_SHAPES, number_from_hash
from learn.layer import render
from manifests import exr, ids, light_files
from manifests import materials as catalogue
from manifests.line_files import Lines
from manifests.schema import (
    Camera,
    Dataset,
    LightEntry,
    MaterialEntry,
    Record,
    ShapeEntry,
    Statistics,
    View,
)
from manifests.splits import split_of
from manifests.store import Store
from manifests.store_paths import geometry_path, image_path, light_path
from manifests.viewpoints import azimuths_deg
from shaders import envmap, frames
from shaders.mixture import Mixture

ALBEDO = 0.4
DIGITS = 12
# a shape that is for validation, where it is on the side of training
VALIDATION = next(
    f"ball:{k}" for k in range(1000) if number_from_hash(f"ball:{k}", VALIDATION_SHAPES) == 0
)
SHAPE, LIGHT, RENDER = "5" * 64, "a" * 64, "synthetic"  # stand-ins of hashes


def matte(name="matte", albedo=ALBEDO, split="train", node_fit=0.0):
    """A material whose label and mixture are the same Lambert surface: c^γ = 1 for γ → 0, f =
    expm1(κ) = albedo/π.

    node_fit  the display L2 between label and nodes that its catalogue entry states
    """
    m = np.full((3, 3, 2, 6), 1e-9)
    m[:, 0, 0] = np.log1p(albedo / np.pi)
    return entry(name, m, Mixture.lambert([albedo] * 3), split, node_fit)


def glossy(name="glossy", split="train", gamma=4e3):
    """A material with a lobe that is narrower than a texel, over a matte one.

    Its mixture is the matte one alone: for tests that render by the label.
    """
    m = np.full((3, 3, 2, 6), 1e-9)
    m[:, 0, 0] = np.log1p(0.1 / np.pi)
    m[:, 1] = np.array([6.0, gamma])[:, None]
    return entry(name, m, Mixture.lambert([0.1] * 3), split)


def entry(name, m, mixture, split="train", node_fit=0.0):
    # processors round the last digit of logarithms differently, and ids, which decide what tests
    # draw, hash all digits
    label = tuple(np.log(m).round(DIGITS).reshape(-1).tolist())
    nodes = msgspec.convert(mixture.to_json(digits=DIGITS), catalogue.MixtureData)
    distance = catalogue.Distance(l1=(0.0,) * 6, display_l2=(node_fit,) * 3)
    return catalogue.Entry(
        name=name,
        family="test",
        source="computed",
        licence="CC0",
        split=split,
        hash=catalogue.material_hash(label, nodes),
        errors=catalogue.Errors(
            nodes_vs_label=distance, nodes_vs_source=distance, label_vs_source=distance
        ),
        label=label,
        mixture=nodes,
    )


def sphere(camera):
    """normals (H, W, 3) and mask (H, W) of the unit sphere seen from far away."""
    x, y = (axis * camera.half_extent for axis in frames.pixel_grid(*camera.size))
    inside = x * x + y * y < 1
    z = np.sqrt(np.where(inside, 1 - x * x - y * y, 0))
    return np.where(inside[..., None], np.stack([x, y, z], -1), 0).astype(np.float32), inside


def write_exr(path, channels):
    exr.write(path, channels)


def write_dataset(
    folder,
    materials,
    rng,
    size=24,
    seeds=2,
    noise=0.02,
    rotations=(0, 5),
    fov_deg=None,
    roll_deg=0.0,
    elevation_deg=20.0,
    tiers=("direct",),
    method="exact",
    category="primitive",
    side="train",
):
    """A dataset in `folder`: every material under one random light at each rotation; pictures by
    the layer, times noise.

    noise           relative standard deviation of a pixel's value
    category, side  of the one shape there is
    Returns         the folder's Store
    """
    store = Store(folder)
    camera = Camera(
        size=(size, size), fov_deg=fov_deg, roll_deg=roll_deg, elevation_deg=elevation_deg
    )
    L, scale = envmap.unit_mean(np.exp(rng.standard_normal((64, 128, 3))))
    stored = light_path("sky", LIGHT)
    digest = store.place(stored, light_files.encode_light(L, scale), "test")
    shape = ShapeEntry(
        hash=SHAPE, category=category, side=side, role=side, segments=1, licence="CC0"
    )
    entries = {
        e.name: MaterialEntry(hash=e.hash, side=e.split, licence=e.licence, source=e.source)
        for e in materials
    }
    lights = {
        "sky": LightEntry(hash=LIGHT, file=stored, file_hash=digest, scale=scale, licence="CC0")
    }
    dataset = Dataset(
        settings={RENDER: {}}, shapes={"sphere": shape}, materials=entries, lights=lights
    )
    store.write_json("dataset.json", dataset)
    catalogue.write(
        catalogue.Catalogue(title="test", credit="none", materials=tuple(materials)),
        store.folder / "materials.json",
    )
    normals, mask = sphere(camera)
    view = (
        None
        if fov_deg is None
        else frames.view_vectors(size, size, np.radians(fov_deg)).astype(np.float32)
    )
    if view is not None:
        mask = mask & ((normals * view).sum(-1) > 1e-3)
        normals = np.where(mask[..., None], normals, 0)
    upright = normals @ frames.camera_from_upright(np.radians(roll_deg))
    geometry = {f"normal.{axis}": normals[..., k] for k, axis in enumerate("XYZ")}
    geometry |= {"depth.Z": normals[..., 2], "segment": mask.astype(np.uint32)}
    geometry_hash = store.place(geometry_file(camera), exr.encode(geometry), "test")
    lines = Lines(store.folder / "records" / "worker-00.jsonl")
    for each in materials:
        for turn in rotations:
            scene = (upright, np.exp(np.asarray(each.label)), envmap.roll(L, turn))
            tensors = [torch.from_numpy(np.asarray(array, np.float32))[None] for array in scene]
            seen = None if view is None else torch.from_numpy(view)[None]
            elevation = np.radians(elevation_deg)
            picture = render(*tensors, seen, elevation=elevation, method=method, tolerance=1e-3)
            picture = picture[0].numpy()
            for tier in tiers:
                for seed in range(seeds):
                    noisy = picture * (1 + noise * rng.standard_normal(picture.shape))
                    lines.append(
                        write_record(
                            store,
                            dataset,
                            each.name,
                            turn,
                            tier,
                            seed,
                            noisy,
                            mask,
                            camera,
                            geometry_hash,
                        )
                    )
    lines.close()
    return store


def geometry_file(camera, viewpoint=0):
    """Where the geometry of the shape lies, relative to the folder."""
    return geometry_path(ids.geometry_id(SHAPE, ids.camera_words(camera), viewpoint, RENDER))


def write_record(store, dataset, material, turn, tier, seed, picture, mask, camera, geometry_hash):
    """The Record of one picture, which is put in place."""
    record = Record(
        id="0" * 24,
        shape="sphere",
        shape_hash=SHAPE,
        category=dataset.shapes["sphere"].category,
        viewpoint=0,
        azimuth_deg=0.0,
        camera=camera,
        materials=(material,),
        light="sky",
        light_hash=LIGHT,
        rotation_texels=turn,
        tier=tier,
        light_resolution="64x128",
        samples=1,
        seed=seed,
        image="",
        image_hash="",
        geometry=geometry_file(camera),
        geometry_hash=geometry_hash,
        split=split_of(dataset.shapes["sphere"].side, [dataset.materials[material].side]),
        statistics=Statistics(
            coverage=float(mask.mean()),
            mean=float(picture[mask].mean()),
            max=float(picture[mask].max()),
        ),
        seconds=0.0,
    )
    return with_picture(store, named(record, dataset), picture)


def named(record, dataset):
    """The record with the id, the geometry and the picture's path that follow from everything else
    in it.
    """
    hashes = tuple(dataset.materials[name].hash for name in record.materials)
    camera = ids.camera_words(record.camera)
    shared = ids.shots_digest(
        RENDER, record.shape_hash, hashes, record.light_hash, camera, record.samples
    )
    place = (
        record.viewpoint,
        record.rotation_texels,
        record.tier,
        record.light_resolution,
        record.seed,
    )
    id_ = ids.shot_id(shared, *place)
    geometry = geometry_path(ids.geometry_id(record.shape_hash, camera, record.viewpoint, RENDER))
    azimuth = azimuths_deg()[record.viewpoint]
    return msgspec.structs.replace(
        record, id=id_, image=image_path(id_), geometry=geometry, azimuth_deg=azimuth
    )


def with_picture(store, record, picture):
    """The record with a picture (H, W, 3), which is put in place."""
    channels = {name: picture[..., k].astype(np.float16) for k, name in enumerate("RGB")}
    return msgspec.structs.replace(
        record, image_hash=store.place(record.image, exr.encode(channels), "test")
    )


def rename(store, change):
    """Rewrites every record as change(record), with the ids that follow, its picture under the
    new name.

    dataset.json must hold by now what the records name.
    """
    dataset, (path,) = store.dataset(), store.record_files()
    result = []
    for record in store.records():
        renamed = named(change(record), dataset)
        if renamed.image != record.image:
            (store.folder / renamed.image).parent.mkdir(exist_ok=True)
            (store.folder / record.image).rename(store.folder / renamed.image)
        result.append(renamed)
    path.write_bytes(b"".join(msgspec.json.encode(record) + b"\n" for record in result))
    return result


def exchange(store, material, name=None):
    """Another material in the place of the one of its name, or of `name`, in the catalogue and in
    every record.
    """
    name, dataset = name or material.name, store.dataset()
    path = store.folder / "materials.json"
    held = catalogue.read_catalogue(path)
    entries = tuple(material if each.name == name else each for each in held.materials)
    path.write_bytes(catalogue.encode(msgspec.structs.replace(held, materials=entries)))
    entry = MaterialEntry(
        hash=material.hash, side=material.split, licence=material.licence, source=material.source
    )
    known = {key: value for key, value in dataset.materials.items() if key != name} | {
        material.name: entry
    }
    store.write_json("dataset.json", msgspec.structs.replace(dataset, materials=known))

    def change(record):
        names = tuple(material.name if each == name else each for each in record.materials)
        split = split_of(dataset.shapes[record.shape].side, [known[each].side for each in names])
        return msgspec.structs.replace(record, materials=names, split=split)

    return rename(store, change)


def add_shape(store, name, side):
    """Adds a shape that looks like the first one, with a copy of each of its pictures; returns the
    new records.
    """
    dataset, (path,) = store.dataset(), store.record_files()
    entry = msgspec.structs.replace(
        dataset.shapes["sphere"],
        hash=hashlib.sha256(name.encode()).hexdigest(),
        side=side,
        role=side,
    )
    dataset = msgspec.structs.replace(dataset, shapes={**dataset.shapes, name: entry})
    store.write_json("dataset.json", dataset)
    lines, result = Lines(path), []
    for record in [record for record in store.records() if record.shape == "sphere"]:
        split = split_of(side, [dataset.materials[material].side for material in record.materials])
        words = {"shape": name, "shape_hash": entry.hash, "split": split}
        copy = named(msgspec.structs.replace(record, **words), dataset)
        digest = another_geometry(store, record, copy.geometry, len(dataset.shapes))
        store.place(copy.image, (store.folder / record.image).read_bytes(), "test")
        result.append(msgspec.structs.replace(copy, geometry_hash=digest))
        lines.append(result[-1])
    lines.close()
    return result


def add_sides(store):
    """Add a shape for validation and one for testing to a data set with a shape for training."""
    add_shape(store, VALIDATION, "train")
    add_shape(store, "cube:1", "test")


def another_geometry(store, record, path, number):
    """A geometry file like a record's, with other depths, so that its hash is another; returns
    that.
    """
    channels = exr.read(store.folder / record.geometry)
    channels["depth.Z"] = channels["depth.Z"] * (1 + 2.0**-8 * number)
    return store.place(path, exr.encode(channels), "test")


def view_of(store, record, viewpoint=None):
    """The View of a record's geometry; of another viewpoint, with a file of its own."""
    shared = {
        key: getattr(record, key) for key in View.__struct_fields__ if key not in ("side", "id")
    }
    side = store.dataset().shapes[record.shape].side
    if viewpoint is not None:
        camera = ids.camera_words(record.camera)
        path = geometry_path(ids.geometry_id(record.shape_hash, camera, viewpoint, RENDER))
        shared |= {
            "viewpoint": viewpoint,
            "azimuth_deg": azimuths_deg()[viewpoint],
            "geometry": path,
        }
        shared["geometry_hash"] = another_geometry(store, record, path, 100 + viewpoint)
    return View(**shared, id=shared["geometry"].rpartition("/")[2].removesuffix(".exr"), side=side)
