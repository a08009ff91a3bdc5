"""Plans of rooms and open skies, drawn from a seed.

factory.render.panorama renders them into light maps.

World axes: x east, y north, z up; metres. The panorama is taken at the origin, so that everything
is placed about it; the floor lies at z = −height of the eye.
"""

from dataclasses import dataclass, field

import numpy as np

Triple = tuple[float, float, float]
SOURCE = "brdfactory lights make"

FURNITURE = ("sofa", "chair", "table", "lamp", "monitor", "vessel", "cushion", "toy")
SIZES = {  # radius in metres of the sphere about a piece of furniture
    "sofa": (0.9, 1.3), "chair": (0.45, 0.65), "table": (0.5, 1.1), "lamp": (0.3, 0.9),
    "monitor": (0.25, 0.5), "vessel": (0.1, 0.35), "cushion": (0.2, 0.4), "toy": (0.15, 0.4),
}  # fmt: skip
SEEDS = 12  # of each kind of furniture: at 64×128 more add nothing, and these stay in memory
LAMP_COLOURS = ((1.0, 0.62, 0.33), (1.0, 0.78, 0.58), (1.0, 0.92, 0.84), (0.85, 0.93, 1.0))


@dataclass(frozen=True)
class Pattern:
    """What is on a surface beside its colour (factory.render.patterns draws it).

    kind    of factory.lights.surroundings.KINDS
    colour  the second one
    size    in metres, of what repeats
    turn    radians, within the surface
    offset  metres along the surface, so that no two surfaces show the same place of a pattern
    """

    kind: str
    colour: Triple
    size: float
    turn: float = 0.0
    offset: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True)
class Material:
    """A Principled material; emission in W/(m² sr) makes it a lamp.

    part  of a scene that is made of it: "wall", "floor", "ceiling", "ground", "building",
          "picture", "furniture" or "table"
    """

    colour: Triple
    roughness: float = 0.6
    metallic: float = 0.0
    emission: float = 0.0
    part: str = ""
    pattern: Pattern | None = None


@dataclass(frozen=True)
class Box:
    """An axis-aligned box from `low` to `high`."""

    low: Triple
    high: Triple
    material: Material


@dataclass(frozen=True)
class Bulb:
    """A sphere that may glow."""

    centre: Triple
    radius: float
    material: Material


@dataclass(frozen=True)
class Furniture:
    """A shape of factory.shapes.catalogue that stands at `place` (its lowest point), turned by
    `azimuth` radians; `radius` is that of the sphere around it.
    """

    spec: str
    place: Triple
    radius: float
    azimuth: float
    material: Material


@dataclass(frozen=True)
class Sky:
    """The sky outside: the sun's elevation and azimuth in radians, dust and strength."""

    elevation: float
    azimuth: float
    dust: float
    strength: float
    with_sun: bool


@dataclass(frozen=True)
class Scene:
    """What a panorama shows."""

    sky: Sky
    boxes: tuple[Box, ...] = ()
    bulbs: tuple[Bulb, ...] = ()
    furniture: tuple[Furniture, ...] = field(default=())


def draw(seed: int) -> Scene:
    """Return the scene of a seed: two of three are rooms, one of three lies under the open sky."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(211,)))
    return _outdoors(rng) if rng.random() < 0.33 else _room(rng)


def _sky(rng: np.random.Generator, strength: float) -> Sky:
    return Sky(
        elevation=float(np.radians(rng.uniform(-2, 75))),
        azimuth=float(rng.uniform(0, 2 * np.pi)),
        dust=float(rng.uniform(0, 5)),
        strength=strength,
        with_sun=bool(rng.random() < 0.7),
    )


def _paint(
    rng: np.random.Generator, brightness: tuple[float, float], colour: float, part: str
) -> Material:
    """A matte or glossy surface; colour: how far from grey it may be."""
    value = rng.uniform(*brightness)
    tint = np.clip(1 + colour * rng.normal(size=3), 0.05, 1.6)
    red, green, blue = (float(c) for c in np.clip(value * tint, 0.01, 0.95))
    metal = float(rng.random() < 0.08)
    return Material((red, green, blue), float(rng.uniform(0.1, 0.9)), metal, part=part)


def _lamp(rng: np.random.Generator, watts: float, area: float) -> Material:
    """A lamp's surface that sends `watts` of light evenly from `area` square metres."""
    return Material(
        LAMP_COLOURS[int(rng.integers(len(LAMP_COLOURS)))], emission=watts / (np.pi * area)
    )


def _room(rng: np.random.Generator) -> Scene:
    size = rng.uniform((3.0, 3.0, 2.3), (9.0, 7.0, 3.8))
    eye = rng.uniform((0.3, 0.3, 0.25), (0.7, 0.7, 0.5)) * size
    low, high = -eye, size - eye
    wall = _paint(rng, (0.3, 0.85), 0.08, "wall")
    floor = _paint(rng, (0.08, 0.6), 0.25, "floor")
    ceiling = _paint(rng, (0.6, 0.9), 0.04, "ceiling")
    boxes = [
        _box(low - 0.2, (high[0] + 0.2, high[1] + 0.2, low[2]), floor),
        _box((low[0] - 0.2, low[1] - 0.2, high[2]), high + 0.2, ceiling),
    ]
    street = low[2] - rng.uniform(0.3, 12.0)
    outside = _paint(rng, (0.05, 0.4), 0.2, "ground")
    boxes.append(_box((-300, -300, street - 1), (300, 300, street), outside))
    windows = set(rng.permutation(4)[: int(rng.choice([0, 1, 2, 3], p=[0.2, 0.4, 0.3, 0.1]))])
    for side in range(4):
        boxes += _wall(rng, low, high, side, wall, side in windows)
    bulbs: list[Bulb] = []
    count = int(rng.integers(0 if windows else 1, 5))
    for _ in range(count):
        _add_lamp(rng, low, high, boxes, bulbs)
    if rng.random() < 0.7:
        for _ in range(int(rng.integers(1, 6))):
            boxes.append(_picture(rng, low, high))
    pieces = [_piece(rng, low, high) for _ in range(int(rng.integers(2, 9)))]
    # dimmer or brighter than the open sky, so that lamps and windows compete
    sky = _sky(rng, float(np.exp(rng.uniform(np.log(0.3), np.log(3)))))
    return Scene(sky, tuple(boxes), tuple(bulbs), tuple(pieces))


def _box(low, high, material: Material) -> Box:
    a, b, c = (float(v) for v in low)
    d, e, f = (float(v) for v in high)
    return Box((a, b, c), (d, e, f), material)


def _wall(rng, low, high, side, material, with_window) -> list[Box]:
    """One of four walls, 0.2 m thick, as one box, or as four about a window."""
    axis, end = side // 2, side % 2
    along = 1 - axis
    near, far = (high[axis], high[axis] + 0.2) if end else (low[axis] - 0.2, low[axis])

    def part(start, finish, bottom, top):
        a, b = np.zeros(3), np.zeros(3)
        a[axis], b[axis], a[along], b[along], a[2], b[2] = near, far, start, finish, bottom, top
        return _box(a, b, material)

    start, finish = low[along] - 0.2, high[along] + 0.2
    if not with_window:
        return [part(start, finish, low[2], high[2])]
    width = rng.uniform(0.25, 0.85) * (finish - start - 0.8)
    left = rng.uniform(start + 0.4, finish - 0.4 - width)
    sill = low[2] + rng.uniform(0.02, 0.4) * (high[2] - low[2])
    lintel = high[2] - rng.uniform(0.05, 0.25) * (high[2] - low[2])
    panes = [
        part(start, left, low[2], high[2]),
        part(left + width, finish, low[2], high[2]),
        part(left, left + width, low[2], sill),
        part(left, left + width, lintel, high[2]),
    ]
    for number in range(int(rng.integers(0, 4))):  # bars
        middle = left + width * (number + 1) / 4
        panes.append(part(middle - 0.02, middle + 0.02, sill, lintel))
    return panes


def _add_lamp(rng, low, high, boxes, bulbs) -> None:
    """Add a bulb that hangs, a panel under the ceiling, or a strip along a wall."""
    watts = float(np.exp(rng.uniform(np.log(5), np.log(120))))
    place = rng.uniform(low + 0.4, high - 0.4)
    kind = rng.choice(["bulb", "panel", "strip"], p=[0.5, 0.3, 0.2])
    if kind == "bulb":
        radius = float(rng.uniform(0.04, 0.25))
        drop = rng.uniform(0.1, 1.2) if rng.random() < 0.7 else high[2] - low[2] - 0.6
        place[2] = high[2] - drop
        if np.linalg.norm(place) > radius + 0.5:
            x, y, z = (float(v) for v in place)
            bulbs.append(Bulb((x, y, z), radius, _lamp(rng, watts, 4 * np.pi * radius**2)))
    else:
        half = (
            rng.uniform(0.1, 0.6, 2) if kind == "panel" else np.array([0.05, rng.uniform(0.4, 1)])
        )
        start = np.array([place[0] - half[0], place[1] - half[1], high[2] - 0.06])
        finish = np.array([place[0] + half[0], place[1] + half[1], high[2] - 0.03])
        boxes.append(_box(start, finish, _lamp(rng, watts, float(4 * half[0] * half[1]))))


def _picture(rng, low, high) -> Box:
    """A coloured panel on a wall."""
    axis, end = int(rng.integers(2)), int(rng.integers(2))
    along = 1 - axis
    half = rng.uniform(0.15, 0.6, 2)
    a, b = np.zeros(3), np.zeros(3)
    a[axis], b[axis] = (high[axis] - 0.03, high[axis]) if end else (low[axis], low[axis] + 0.03)
    centre = rng.uniform(low[along] + 0.6, high[along] - 0.6), rng.uniform(0.0, high[2] - 0.6)
    a[along], b[along] = centre[0] - half[0], centre[0] + half[0]
    a[2], b[2] = centre[1] - half[1], centre[1] + half[1]
    return _box(a, b, _paint(rng, (0.05, 0.8), 0.6, "picture"))


def _piece(rng, low, high) -> Furniture:
    family = str(rng.choice(FURNITURE))
    radius = float(rng.uniform(*SIZES[family]))
    for _ in range(8):
        place = rng.uniform(low + 0.3, high - 0.3)
        if np.hypot(place[0], place[1]) > radius + 0.5:
            break
    material = _paint(rng, (0.03, 0.8), 0.5, "furniture")
    spec = f"{family}:{int(rng.integers(SEEDS))}"
    spot = (float(place[0]), float(place[1]), float(low[2]))
    return Furniture(spec, spot, radius, float(rng.uniform(0, 2 * np.pi)), material)


def _outdoors(rng: np.random.Generator) -> Scene:
    """Ground, perhaps buildings and things that stand about, under the sky."""
    eye = rng.uniform(0.8, 1.8)
    ground = _paint(rng, (0.05, 0.5), 0.25, "ground")
    boxes = [_box((-300, -300, -eye - 1), (300, 300, -eye), ground)]
    for _ in range(int(rng.choice([0, 2, 6, 14]))):
        distance, angle = rng.uniform(6, 60), rng.uniform(0, 2 * np.pi)
        size = rng.uniform((2, 2, 2), (14, 14, 25)) * min(1.0, distance / 20)
        centre = distance * np.array([np.cos(angle), np.sin(angle)])
        if np.abs(centre).max() < size[:2].max() / 2 + 1.5:
            continue
        start = (centre[0] - size[0] / 2, centre[1] - size[1] / 2, -eye)
        finish = (centre[0] + size[0] / 2, centre[1] + size[1] / 2, size[2] - eye)
        boxes.append(_box(start, finish, _paint(rng, (0.08, 0.7), 0.25, "building")))
    low, high = np.array([-6.0, -6.0, -eye]), np.array([6.0, 6.0, 3.0])
    pieces = [_piece(rng, low, high) for _ in range(int(rng.integers(0, 5)))]
    return Scene(_sky(rng, 1.0), tuple(boxes), (), tuple(pieces))
