"""Small data sets that are whole and true to the contract, made without Cycles: ids, seeds, hashes,
contents, orders.

Shapes are spheres, parted into segments by longitude; pictures are shaded by the normal alone, with
noise. Whatever the contract says of a data set holds for these, so that `verify` has nothing to say
of them.
"""

import hashlib
from itertools import product

import numpy as np

from manifests import ids
from manifests.light_files import encode_light
from manifests.line_files import Lines
from manifests.materials import (
    Catalogue,
    Distance,
    Entry,
    Errors,
    MixtureData,
    encode,
    material_hash,
)
from manifests.picture_files import Geometry, encode_geometry, encode_picture, read_geometry
from manifests.schema import (
    Camera,
    Dataset,
    Job,
    LightEntry,
    MaterialEntry,
    Order,
    Record,
    ShapeEntry,
    Statistics,
    View,
)
from manifests.splits import SIDES, light_side, role_of, split_of
from manifests.store import Store
from manifests.store_paths import geometry_path, image_path, light_path
from manifests.viewpoints import azimuths_deg
from shaders import envmap, frames
from shaders.tone import LUMINANCE

RENDER = "0123456789abcdef"
JOB = Job(
    shapes=("ball", "globe"),
    materials=("matte", "grey"),
    lights=("lamp",),
    views=(0, 6),
    rotations=(3,),
    samples=4,
    camera=Camera(size=(16, 16)),
)


def hash_of(name: str) -> str:
    """A stand-in hash of a shape or a light."""
    return hashlib.sha256(name.encode()).hexdigest()


def entry(name: str, level: float, split: str = "train") -> Entry:
    """A plain material of the catalogue; level tells materials apart."""
    nothing = Distance(l1=(0.0,) * 6, display_l2=(0.0, 0.0, 0.0))
    label = (level,) * 108
    mixture = MixtureData(("diffuse",), (0.0,), ((0.0,),), ((0.0,),), (((0.5, 0.5, 0.5),),))
    return Entry(
        name=name,
        family="test",
        source="computed",
        licence="CC0",
        split=split,
        hash=material_hash(label, mixture),
        errors=Errors(nothing, nothing, nothing),
        label=label,
        mixture=mixture,
    )


def geometry_of(camera: Camera, segments: int, radius: float = 0.99) -> Geometry:
    """A sphere, its visible half parted into segments from left to right."""
    height, width = camera.size
    x, y = (axis * camera.half_extent for axis in frames.pixel_grid(height, width))
    # a ray through the pixel meets the sphere; a perspective camera's frame spans 2 half_extent at
    # the centre
    origin, ray = (
        np.stack([x, y, np.full_like(x, 2.0)], -1),
        np.broadcast_to([0.0, 0.0, -1.0], (height, width, 3)),
    )
    if camera.fov_deg is not None:
        away = camera.half_extent / np.tan(np.radians(camera.fov_deg) / 2)
        origin, ray = np.array([0.0, 0.0, away]), np.stack([x, y, np.full_like(x, -away)], -1)
        ray = ray / np.linalg.norm(ray, axis=-1, keepdims=True)
    near = -(origin * ray).sum(-1)
    inside = near**2 - (origin**2).sum(-1) + radius**2
    mask = inside > 0.02
    place = origin + ray * (near - np.sqrt(np.where(mask, inside, 0)))[..., None]
    normals, depth = np.where(mask[..., None], place / radius, 0), np.where(mask, -place[..., 2], 0)
    parts = 1 + np.minimum((np.arange(width) * segments) // width, segments - 1)
    parts = np.broadcast_to(parts, (height, width)) * mask
    return Geometry(normals.astype(np.float32), depth.astype(np.float32), parts.astype(np.uint8))


def write_dataset(folder, job: Job = JOB, segments: int = 1, seed: int = 0) -> Store:
    """A data set of everything that a job means; its shapes and lights are known by name alone.

    job       materials are names; with `segment_materials` None each shape is of one material
    segments  of each shape
    """
    store, rng = Store(folder), np.random.default_rng(seed)
    labels = [entry(name, -1.0 - 0.1 * k) for k, name in enumerate(job.materials)]
    store.place(
        "materials.json", encode(Catalogue(title="t", credit="c", materials=tuple(labels))), "t"
    )
    hashes = {label.name: label.hash for label in labels}
    shapes = {}
    for name in job.shapes:
        role = role_of(name, "primitive", hash_of(name), job.split)
        words = {
            "category": "primitive",
            "role": role,
            "side": SIDES[role],
            "segments": segments,
            "licence": "CC0",
        }
        shapes[name] = ShapeEntry(hash=hash_of(name), **words)
    lights = {name: _light(store, rng, name) for name in job.lights}
    files = {}
    records = Lines(store.folder / ("records" if job.pictures else "views") / "worker-00.jsonl")
    if job.pictures:
        combinations = list(product(shapes, [(name,) * segments for name in hashes], lights))
        for shape, names, light in combinations:
            for record in _records(
                store, rng, job, files, shapes, hashes, lights, shape, names, light
            ):
                records.append(record)
    else:
        for view in _views(store, job, files, shapes):
            records.append(view)
    records.close()
    materials = {
        e.name: MaterialEntry(hash=e.hash, side=e.split, licence=e.licence, source=e.source)
        for e in labels
    }
    orders = (
        Order(
            job=job,
            shots=sum(1 for _ in [*store.records(), *store.views()]),
            begun="2026-01-01T00:00:00+00:00",
        ),
    )
    dataset = Dataset(
        orders=orders, settings={RENDER: {}}, shapes=shapes, materials=materials, lights=lights
    )
    store.write_json("dataset.json", dataset)
    return store


def _light(store, rng, name):
    """A stored light of random texels."""
    L, scale = envmap.unit_mean(np.exp(0.5 * rng.standard_normal((64, 128, 3))))
    file = light_path(name, hash_of(name))
    digest = store.place(file, encode_light(L, scale), "t")
    words = {
        "hash": hash_of(name),
        "file": file,
        "file_hash": digest,
        "scale": scale,
        "licence": "CC0",
    }
    return LightEntry(**words, side=light_side(hash_of(name)))


def _geometry(store, job, files, shapes, shape, view):
    """(path, hash, Geometry) of a shape's view, the file put in place once."""
    id_ = ids.geometry_id(shapes[shape].hash, ids.camera_words(job.camera), view, RENDER)
    if id_ not in files:
        # no two alike
        seen = geometry_of(job.camera, shapes[shape].segments, 0.99 - 0.02 * len(files))
        digest = store.place(geometry_path(id_), encode_geometry(seen), "t")
        files[id_] = (
            id_,
            geometry_path(id_),
            digest,
            read_geometry(store.folder / geometry_path(id_)),
        )
    return files[id_]


def _records(store, rng, job, files, shapes, hashes, lights, shape, names, light):
    """The records of one combination, their pictures put in place."""
    material_hashes = tuple(hashes[name] for name in names)
    key = ids.combination_key(shapes[shape].hash, material_hashes, lights[light].hash, 0)
    word, views, turns = ids.draws(job, key)
    camera = ids.camera_words(job.camera)
    shared = ids.shots_digest(
        RENDER, shapes[shape].hash, material_hashes, lights[light].hash, camera, job.samples
    )
    for view, rotations in zip(views, turns, strict=True):
        _, path, digest, geometry = _geometry(store, job, files, shapes, shape, view)
        mask = geometry.mask
        for place in product(rotations, job.tiers, job.light_resolutions, range(job.repeats)):
            seed = ids.shot_seed(word, ids.shot_place(view, *place))
            id_ = ids.shot_id(shared, view, *place[:3], seed)
            level = 0.2 + 0.5 * rng.random(3)
            radiance = np.clip(
                geometry.normals[..., 2:] * level * rng.lognormal(0, 0.1, (*mask.shape, 3)),
                1e-3,
                None,
            )
            radiance = (radiance * mask[..., None]).astype(np.float32)
            inside = radiance[mask]
            yield Record(
                id=id_,
                shape=shape,
                shape_hash=shapes[shape].hash,
                category=shapes[shape].category,
                viewpoint=view,
                azimuth_deg=azimuths_deg()[view],
                camera=job.camera,
                materials=names,
                light=light,
                light_hash=lights[light].hash,
                rotation_texels=place[0],
                tier=place[1],
                light_resolution=place[2],
                samples=job.samples,
                seed=seed,
                image=image_path(id_),
                image_hash=store.place(image_path(id_), encode_picture(radiance), "t"),
                geometry=path,
                geometry_hash=digest,
                split=split_of(shapes[shape].side, ["train"] * len(names)),
                statistics=Statistics(
                    coverage=round(float(mask.mean()), 6),
                    mean=round(float(inside.mean(axis=0, dtype=np.float64) @ LUMINANCE), 6),
                    max=round(float(inside.max()), 6),
                ),
                seconds=0.1,
            )


def _views(store, job, files, shapes):
    """The views of a job without pictures."""
    for name, shape in shapes.items():
        for view in ids.views_alone(job, shape.hash):
            id_, path, digest, geometry = _geometry(store, job, files, shapes, name, view)
            yield View(
                id=id_,
                shape=name,
                shape_hash=shape.hash,
                category=shape.category,
                viewpoint=view,
                azimuth_deg=azimuths_deg()[view],
                camera=job.camera,
                segments=shape.segments,
                geometry=path,
                geometry_hash=digest,
                side=shape.side,
                coverage=round(float(geometry.mask.mean()), 6),
                seconds=0.1,
            )
