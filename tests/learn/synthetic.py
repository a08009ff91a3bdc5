"""Small datasets whose pictures are computed here instead of in Cycles: a sphere, known materials, known light, known noise."""

import hashlib
import io

import msgspec
import numpy as np
import torch

from learn.layer import render
from manifests import exr
from manifests import materials as catalogue
from manifests.schema import Camera, Dataset, LightEntry, Record, Statistics
from manifests.store import Lines, Store, geometry_path, image_path, light_path
from shaders import envmap, frames
from shaders.mixture import Mixture

ALBEDO = 0.4
GEOMETRY = "9" * 24  # id of the one geometry file


def matte(name="matte", albedo=ALBEDO):
    """A material whose label and mixture are the same Lambert surface: c^γ = 1 for γ → 0, f = expm1(κ) = albedo/π."""
    m = np.full((3, 3, 2, 6), 1e-9)
    m[:, 0, 0] = np.log1p(albedo / np.pi)
    return entry(name, m, Mixture.lambert([albedo] * 3))


def entry(name, m, mixture):
    distance = catalogue.Distance(l1=(0.0,) * 6, display_l2=(0.0, 0.0, 0.0))
    label = tuple(np.log(m).reshape(-1).tolist())
    data = msgspec.convert(mixture.to_json(digits=12), catalogue.MixtureData)
    return catalogue.Entry(
        name=name,
        family="test",
        source="computed",
        licence="CC0",
        split="train",
        hash=catalogue.material_hash(label, data),
        errors=catalogue.Errors(nodes_vs_label=distance, nodes_vs_source=distance, label_vs_source=distance),
        label=label,
        mixture=data,
    )


def sphere(camera):
    """normals (H, W, 3) and mask (H, W) of the unit sphere seen from far away."""
    x, y = (axis * camera.half_extent for axis in frames.pixel_grid(*camera.size))
    inside = x * x + y * y < 1
    z = np.sqrt(np.where(inside, 1 - x * x - y * y, 0))
    return np.where(inside[..., None], np.stack([x, y, z], -1), 0).astype(np.float32), inside


def write_exr(path, channels):
    exr.write(path, channels)


def write_dataset(folder, materials, rng, size=24, seeds=2, noise=0.02, rotations=(0, 5), fov_deg=None, tiers=("direct",), method="exact"):
    """A dataset in `folder`: every material under one random light at each rotation; pictures by the layer, times noise.

    noise    relative standard deviation of a pixel's value
    Returns  the folder's Store
    """
    store, camera = Store(folder), Camera(size=(size, size), fov_deg=fov_deg)
    L, scale = envmap.unit_mean(np.exp(rng.standard_normal((64, 128, 3))))
    buffer = io.BytesIO()
    np.savez(buffer, L=L, scale=np.float64(scale))
    stored = light_path("sky", "a" * 64)
    digest = store.place(stored, buffer.getvalue(), "test")
    lights = {"sky": LightEntry(hash="a" * 64, file=stored, file_hash=digest, scale=scale, licence="CC0")}
    store.write_json("dataset.json", Dataset(lights=lights))
    catalogue.write(catalogue.Catalogue(title="test", credit="none", materials=tuple(materials)), store.folder / "materials.json")
    normals, mask = sphere(camera)
    view = None if fov_deg is None else frames.view_vectors(size, size, np.radians(fov_deg)).astype(np.float32)
    if view is not None:
        mask = mask & ((normals * view).sum(-1) > 1e-3)
        normals = np.where(mask[..., None], normals, 0)
    geometry = {f"normal.{axis}": normals[..., k] for k, axis in enumerate("XYZ")}
    geometry |= {"depth.Z": normals[..., 2], "segment": mask.astype(np.uint32)}
    store.place(geometry_path(GEOMETRY), exr.encode(geometry), "test")
    lines = Lines(store.folder / "records" / "worker-00.jsonl")
    for each in materials:
        for turn in rotations:
            arrays = (normals, np.exp(np.asarray(each.label)), envmap.roll(L, turn))
            tensors = [torch.from_numpy(np.asarray(array, np.float32))[None] for array in arrays]
            seen = None if view is None else torch.from_numpy(view)[None]
            picture = render(*tensors, seen, method=method, tolerance=1e-3)[0].numpy()
            for tier in tiers:
                for seed in range(seeds):
                    noisy = picture * (1 + noise * rng.standard_normal(picture.shape))
                    lines.append(write_record(store, each.name, turn, tier, seed, noisy, mask, camera))
    lines.close()
    return store


def id_of(text):
    """An id of the right form that depends on the text alone."""
    return hashlib.sha256(text.encode()).hexdigest()[:24]


def write_record(store, material, turn, tier, seed, picture, mask, camera):
    order = f"{material[:4].ljust(4).encode().hex()}{turn:03d}{ord(tier[0]):02x}{seed:02d}"
    id_ = (order + id_of(f"{material} {tier}"))[:24]  # ids sort as material, rotation, tier and seed
    channels = {name: picture[..., k].astype(np.float16) for k, name in enumerate("RGB")}
    digest = store.place(image_path(id_), exr.encode(channels), "test")
    return Record(
        id=id_,
        shape="sphere",
        shape_hash="5" * 64,
        category="primitive",
        viewpoint=0,
        azimuth_deg=0.0,
        camera=camera,
        materials=(material,),
        light="sky",
        light_hash="a" * 64,
        rotation_texels=turn,
        tier=tier,
        light_resolution="64x128",
        samples=1,
        seed=seed,
        image=image_path(id_),
        image_hash=digest,
        geometry=geometry_path(GEOMETRY),
        geometry_hash="6" * 64,
        split="train",
        statistics=Statistics(coverage=float(mask.mean()), mean=float(picture[mask].mean()), max=float(picture[mask].max())),
        seconds=0.0,
    )
