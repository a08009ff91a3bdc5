"""The design of the ladder: its rungs, the jobs that render them, and the edits that are measured.

Each rung differs from the one before in one thing. All rungs show the same shapes, views, materials
and lights. A side's preset names them (manifests/jobs/ladder-development.json, ladder-test.json).
The full product would be nine times as much as is measured, so that it is cut into PARTS jobs per
camera: a part has a third of the shapes, lights and materials. Every shape is then shown in two
materials under three lights, while the side has six and nine.
"""

import hashlib
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec

from manifests import JOBS, splits
from manifests.errors import InputError
from manifests.reading import read
from manifests.schema import Camera, Job, LightResolution, Record, Tier

SIDES = ("development", "test", "second-test")
PARTS = 3
OWN = ("car", "chair", "sofa", "monitor")
OWN_GROUP, HELD_OUT_GROUP, SEEN_GROUP, OUTSIDE_GROUP = (
    "own families",
    "held-out families",
    "general families of training",
    "outside meshes",
)
GROUPS = (OWN_GROUP, SEEN_GROUP, HELD_OUT_GROUP, OUTSIDE_GROUP)
MESHES = (".obj", ".ply", ".glb", ".stl", ".off")
# Another camera than that of training: from above, and near enough for perspective. The frame is
# wide enough for the unit sphere, whose outline is 17.6° from the axis.
OTHER_ELEVATION_DEG, OTHER_FOV_DEG, OTHER_HALF_EXTENT = 45.0, 40.0, 1.2
REMEDY = "python -m learn evaluate-ladder --jobs DIR prints the commands"
SETS = ("centre", "square", "camera")  # of records that differ in their camera


@dataclass(frozen=True)
class Rung:
    """A rung of the ladder.

    cameras                 one of SETS: which pictures it reads
    tier, light_resolution  of these pictures
    eight_bit               whether the network gets an 8-bit PNG under automatic exposure, which is
                            read back as a user's photograph is
    title                   in words, for the report
    """

    name: str
    title: str
    cameras: str
    tier: Tier
    light_resolution: LightResolution = "64x128"
    eight_bit: bool = False


RUNGS = (
    Rung("direct", "direct light only", "centre", "direct"),
    Rung("shadow", "with shadows", "centre", "shadow"),
    Rung("full", "with interreflection", "centre", "full"),
    Rung("square", "square pixels, full-resolution light", "square", "full", "full"),
    Rung("8-bit", "8-bit PNG, automatic exposure", "square", "full", "full", True),
    Rung("camera", "8-bit PNG, unknown camera", "camera", "full", "full", True),
)
HEADLINE = "8-bit"  # the rung of headline figures
# rungs of the presets that do not have all
RUNGS_OF = {"ladder-second-test": ("direct", HEADLINE)}


@dataclass(frozen=True)
class Scene:
    """An edit that is measured on every rung.

    shape, light  names; group one of GROUPS; family the shape's, or its category
    source        {rung: Record} of the picture that is decomposed
    truth         {rung: Record} of the same in the target material
    """

    shape: str
    light: str
    group: str
    family: str
    source: Mapping[str, Record]
    truth: Mapping[str, Record]

    @property
    def id(self) -> str:
        """The id of the scene, of its direct pictures, or of its first ones if it has none."""
        first = RUNGS[0].name if RUNGS[0].name in self.source else next(iter(self.source))
        return f"{self.source[first].id}-{self.truth[first].id}"


def preset(side: str) -> Job:
    """Return the job of one of SIDES. Raises InputError for a damaged file."""
    return read(JOBS / f"ladder-{side}.json", Job)


def rungs_of(job: Job) -> tuple[Rung, ...]:
    """Return the rungs of a preset, in order; all of them where RUNGS_OF has no entry."""
    names = RUNGS_OF.get(job.name, tuple(rung.name for rung in RUNGS))
    return tuple(rung for rung in RUNGS if rung.name in names)


def group_of(shape: str, category: str) -> tuple[str, str]:
    """Return the group (one of GROUPS) and the family of a shape by its name and category.

    A shape whose name is not that of a family and a number is an outside mesh.
    """
    number = splits.NUMBERED.match(shape)
    family = number[1] if number else ""
    if family in OWN:
        return OWN_GROUP, family
    if splits.is_test_only(shape):
        return HELD_OUT_GROUP, family
    known = splits.rules()["general"]["shapes"].get(family)
    if known is None:
        return OUTSIDE_GROUP, category
    return (HELD_OUT_GROUP if "test" in known else SEEN_GROUP), family


def cameras(job: Job) -> dict[str, Camera]:
    """Return {one of SETS: Camera} of a preset."""
    replace = msgspec.structs.replace
    return {
        "centre": replace(job.camera, pixel="centre"),
        "square": replace(job.camera, pixel="square"),
        "camera": replace(
            job.camera,
            pixel="square",
            elevation_deg=OTHER_ELEVATION_DEG,
            fov_deg=OTHER_FOV_DEG,
            half_extent=OTHER_HALF_EXTENT,
        ),
    }


def outside_meshes(folder: Path, count: int) -> list[str]:
    """Return up to `count` mesh files below a folder, relative to it.

    They are those whose paths have the smallest hashes, so that no taste is involved. Raises
    InputError where there are none.
    """
    paths = [
        path.relative_to(folder).as_posix()
        for path in Path(folder).rglob("*")
        if path.suffix.lower() in MESHES and path.is_file()
    ]
    if not paths:
        raise InputError(
            folder, f"mesh files ({', '.join(MESHES)})", "none", "leave --meshes out, or add some"
        )
    return sorted(paths, key=lambda path: hashlib.sha256(path.encode()).digest())[:count]


def jobs(job: Job, meshes: Sequence[str] = ()) -> dict[str, Job]:
    """Return {name: Job} of the jobs that render a side: PARTS for each camera that it has.

    meshes  paths of outside meshes, relative to the folder that is given to `--assets`
    """
    shapes = [*_each(job.shapes), *meshes]
    result = {}
    for part in range(PARTS):
        for set_, camera in cameras(job).items():
            name = f"{job.name}-{set_}-{part}"
            rungs = [rung for rung in rungs_of(job) if rung.cameras == set_]
            if not rungs:
                continue
            result[name] = msgspec.structs.replace(
                job,
                name=name,
                about=f"part {part + 1} of {PARTS} of {job.name}",
                shapes=tuple(shapes[part::PARTS]),
                materials=tuple(_block(job.materials, part)),
                lights=tuple(_block(job.lights, part)),
                tiers=tuple(dict.fromkeys(rung.tier for rung in rungs)),
                light_resolutions=tuple(dict.fromkeys(rung.light_resolution for rung in rungs)),
                camera=camera,
            )
    return result


def light_seeds(job: Job) -> list[int]:
    """Return the seeds of a preset's lights that `factory lights make` renders, in order."""
    made = [name.removeprefix("interior-") for name in job.lights]
    return [int(number) for number in made if number.isdigit()]


def _block(names: Sequence[str], part: int) -> Sequence[str]:
    """Lights and materials of a part: consecutive ones, as the preset groups them."""
    size = len(names) // PARTS
    return names[part * size : (part + 1) * size]


def _each(specs: Iterable[str]) -> list[str]:
    """The shapes that a preset's ranges "chair:0-2" mean, seed after seed of each family."""
    result = []
    for spec in specs:
        family, _, numbers = spec.partition(":")
        first, _, last = numbers.partition("-")
        result += [f"{family}:{number}" for number in range(int(first), int(last or first) + 1)]
    return result


def designed_scenes(job: Job) -> int:
    """Return the number of scenes of a side without outside meshes."""
    return len(_each(job.shapes)) * len(job.lights) // PARTS


def scenes(
    records: Iterable[Record],
    job: Job,
    incomplete: bool = False,
    rungs: Sequence[Rung] | None = None,
) -> list[Scene]:
    """Return the edits of a side, in an order in which shapes take turns.

    Of each shape under each light, the source and the target are two of its materials, drawn by a
    hash of the names; both are there on every rung. Records of other cameras, views, lights or
    materials than the preset's are not used.

    incomplete  whether pictures that the preset calls for may be missing; scenes without them on
                any rung are left out
    rungs       that are measured, in the order of RUNGS; None: all that the preset has
    Raises      InputError, with the number of missing pictures, where they may not, and where no
                scene is complete
    """
    rungs = rungs_of(job) if rungs is None else rungs
    by_camera = {camera: set_ for set_, camera in cameras(job).items()}
    pictures: dict[tuple[str, str], dict[tuple[str, str], Record]] = defaultdict(dict)
    for record in records:
        set_ = by_camera.get(record.camera)
        if set_ is None or len(set(record.materials)) > 1 or record.samples != job.samples:
            continue
        if record.light not in job.lights or record.materials[0] not in job.materials:
            continue
        for rung in rungs:
            if (rung.cameras, rung.tier, rung.light_resolution) == (
                set_,
                record.tier,
                record.light_resolution,
            ):
                pictures[record.shape, record.light][rung.name, record.materials[0]] = record
    if not incomplete:
        _require_all(pictures, job, rungs)
    chosen = [
        scene for key, of in pictures.items() if (scene := _scene(*key, of, rungs)) is not None
    ]
    if not chosen:
        raise InputError(
            "--data", f"scenes of {job.name} on every rung", "none", f"render them: {REMEDY}"
        )
    by_shape: dict[str, list[Scene]] = defaultdict(list)
    for scene in sorted(chosen, key=lambda scene: _shuffle(scene.shape, scene.light)):
        by_shape[scene.shape].append(scene)
    order = sorted(by_shape, key=_shuffle)
    rounds = range(max(map(len, by_shape.values())))
    return [by_shape[shape][k] for k in rounds for shape in order if k < len(by_shape[shape])]


def _scene(
    shape: str, light: str, pictures: Mapping[tuple[str, str], Record], rungs: Sequence[Rung]
) -> Scene | None:
    """The edit of one shape under one light; None with fewer than two complete materials."""
    complete = [
        material
        for material in sorted({material for _, material in pictures})
        if all((rung.name, material) in pictures for rung in rungs)
    ]
    if len(complete) < 2:
        return None
    source, truth = sorted(complete, key=lambda name: _shuffle(shape, light, name))[:2]
    first = pictures[rungs[0].name, source]
    group, family = group_of(shape, first.category)
    return Scene(
        shape,
        light,
        group,
        family,
        {rung.name: pictures[rung.name, source] for rung in rungs},
        {rung.name: pictures[rung.name, truth] for rung in rungs},
    )


def _require_all(
    pictures: Mapping[tuple[str, str], Mapping], job: Job, rungs: Sequence[Rung]
) -> None:
    required = [
        (shape, light, rung.name, material)
        for part in range(PARTS)
        for shape in _each(job.shapes)[part::PARTS]
        for light in _block(job.lights, part)
        for material in _block(job.materials, part)
        for rung in rungs
    ]
    missing = [
        (shape, light, rung, material)
        for shape, light, rung, material in required
        if (rung, material) not in pictures.get((shape, light), {})
    ]
    if missing:
        first = ", ".join(missing[0])
        raise InputError(
            "--data",
            f"the {len(required)} pictures of {job.name}'s rungs",
            f"{len(missing)} missing, the first of them {first}",
            f"{REMEDY}, or --incomplete to measure what is there",
        )


def _shuffle(*names: str) -> bytes:
    return hashlib.sha256(" ".join(names).encode()).digest()
