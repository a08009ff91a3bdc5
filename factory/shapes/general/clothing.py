"""What people wear and carry, for testing only: shoes and umbrellas."""

from collections.abc import Callable

import numpy as np

from factory.shapes.assembly import Assembly
from factory.shapes.curves import smooth_path
from factory.shapes.general import fields
from factory.shapes.general.draws import Generator
from factory.shapes.general.isosurface import Field, surface_of
from factory.shapes.lofts import ellipsoid, loft, rod, tube

MATERIAL, TRIM = 1, 2
# half-widths of a foot from heel to toe, as shares of its width, at these places along it
PLACES = np.array([-1.0, -0.8, -0.4, 0.0, 0.35, 0.65, 1.0])
HALF_WIDTHS = np.array([0.66, 0.72, 0.64, 0.72, 0.98, 0.92, 0.5])
BALL = 0.3  # where the foot bends in a raised shoe


def shoe(a: Assembly, rng: Generator) -> None:
    """A trainer, a boot, a slipper or a court shoe. Segments: 1 the upper, 2 sole and laces."""
    kind = str(rng.choice(["trainer", "boot", "slipper", "court"], p=[0.35, 0.3, 0.15, 0.2]))
    width, wall = rng.uniform(0.3, 0.38), rng.uniform(0.045, 0.06)
    lift = rng.uniform(0.35, 0.7) if kind == "court" else rng.uniform(0.0, 0.08)
    toe, instep = rng.uniform(0.2, 0.3), rng.uniform(0.5, 0.62)
    if kind == "court":
        toe, instep = 0.22, 0.34
    outline = _sole_outline(rng, width)
    raised = _raised(lift)
    plan = fields.Outline([outline])

    def foot(inset: float) -> Field:
        def field(p: np.ndarray) -> np.ndarray:
            x, z = p[..., 0], p[..., 2] - raised(p[..., 0])
            roof = z - np.interp(x, [-1, -0.5, 0.1, 0.6, 1], _roof(kind, toe, instep))
            side = plan(x, p[..., 1]) + 0.3 * np.maximum(z - 0.1, 0)
            return 0.8 * _highest([side, 0.8 * roof, -z], 0.12) + inset

        return field

    inner = foot(wall)
    if kind == "boot":
        top = rng.uniform(1.0, 1.9)
        shaft = [_shaft(width * rng.uniform(0.85, 1.1), inset) for inset in (0.0, wall)]
        body = fields.union([foot(0.0), shaft[0]], 0.25)
        inner = fields.union([inner, shaft[1]], 0.25)
        opened = [fields.half_space((0, 0, -1), -top), inner]
    else:
        body = foot(0.0)
        opened = [inner, _opening(kind, rng, raised, instep)]
    middle = (0, 0, -0.5 * (1.9 if kind == "boot" else 0.8))
    upper = surface_of(fields.moved(fields.cut(body, opened, 0.02), middle), 1.35, 112)
    a.add("upper", upper.moved(z=-middle[2]), MATERIAL)
    _add_sole(a, rng, outline, kind, lift)
    if kind in ("trainer", "boot"):
        _add_laces(a, rng, toe, instep, width, raised)


def _sole_outline(rng, width):
    """The outline (N, 2) of a foot of half length 1, its toes at +x, bent to one side."""
    x = -np.cos(np.linspace(0, np.pi, 60))
    share = np.interp(x, PLACES, HALF_WIDTHS * [1, 1, rng.uniform(0.8, 1), 1, 1, 1, 1])
    half = width * share * np.clip(1 - np.abs(x) ** 6, 0, 1) ** 0.5
    bend = rng.choice([-1, 1]) * rng.uniform(0.02, 0.09) * np.sin(np.pi * x)
    left, right = np.stack([x, bend + half], 1), np.stack([x, bend - half], 1)
    return np.concatenate([right, left[-2:0:-1]])


def _raised(lift: float) -> Callable[[np.ndarray], np.ndarray]:
    """How far the foot's bottom is above the floor at x: 0 at the toes, `lift` at the heel."""

    def height(x: np.ndarray) -> np.ndarray:
        t = np.clip((BALL - x) / (BALL + 0.85), 0, 1)
        return lift * t * t * (3 - 2 * t)

    return height


def _roof(kind, toe, instep):
    """Heights of the upper at five places from heel to toe."""
    heel = {"trainer": 0.6, "boot": 0.7, "slipper": 0.16, "court": 0.42}[kind]
    return [heel, heel * 0.95 if kind != "slipper" else 0.3, instep, toe + 0.1, toe]


def _highest(values, blend):
    result = values[0]
    for value in values[1:]:
        share = np.clip(0.5 + 0.5 * (result - value) / blend, 0, 1)
        result = value + share * (result - value) + blend * share * (1 - share)
    return result


def _shaft(half, inset):
    """The leg of a boot: an oval column about the heel."""

    def field(p: np.ndarray) -> np.ndarray:
        widen = 1 + 0.12 * np.maximum(p[..., 2] - 0.6, 0)
        away = np.hypot((p[..., 0] + 0.52) / 1.25, p[..., 1])
        return 0.8 * np.maximum(away - (half - inset) * widen, 0.25 - p[..., 2])

    return field


def _opening(kind, rng, raised, instep):
    """What is cut from above so that a foot can enter."""
    long = {"trainer": 0.36, "slipper": 0.75, "court": 0.66}[kind] * rng.uniform(0.95, 1.05)
    centre = {"trainer": -0.46, "slipper": -0.75, "court": -0.16}[kind]
    low = {"trainer": 0.45 * instep, "slipper": 0.1, "court": 0.12}[kind]

    def field(p: np.ndarray) -> np.ndarray:
        away = (np.hypot((p[..., 0] - centre) / long, p[..., 1] / 0.2) - 1) * 0.2
        return np.maximum(away, low + raised(p[..., 0]) - p[..., 2])

    return field


def _add_sole(a, rng, outline, kind, lift):
    """Add a sole under the outline, with a heel where the shoe is raised."""
    thick = {"trainer": 0.16, "boot": 0.14, "slipper": 0.08, "court": 0.04}[kind]
    thick *= rng.uniform(0.8, 1.3)
    raised = _raised(lift)
    grown = outline * [1.03, 1.12]
    rings = []
    for share, drop in [(0.9, 0.06), (0.99, 0.05), (1.0, 0.02), (1.0, -0.8), (0.97, -1), (0.5, -1)]:
        flat = grown * share
        z = raised(flat[:, 0]) + (drop if drop > 0 else drop * thick)
        rings.append(np.column_stack([flat, z]))
    a.add("sole", loft(rings), TRIM)
    if lift > 0.1:
        slim = rng.uniform(0.05, 0.12)
        top = [-0.72, 0, lift - 0.02]
        a.add("heel", rod([-0.78, 0, -thick], top, slim, [0.17, 0.17], around=20), TRIM)
    elif kind == "boot":
        half = rng.uniform(0.2, 0.26)
        heel = ellipsoid([0.62, 2 * half, 0.3], square=5.0, around=28)
        a.add("heel", heel.moved(-0.64, 0, -thick - 0.08), TRIM)


def _add_laces(a, rng, toe, instep, width, raised):
    rows = int(rng.integers(3, 6))
    for x in np.linspace(0.02, 0.42, rows):
        top = np.interp(x, [0.1, 0.6, 1], [instep, toe + 0.1, toe]) + float(raised(np.array(x)))
        wide = width * rng.uniform(0.55, 0.65)
        bow = [[x, -wide, top - 0.12], [x, 0, top + 0.03], [x, wide, top - 0.12]]
        a.add("lace", tube(smooth_path(bow, 12), 0.028, around=10, bevel=1.0), TRIM)


def umbrella(a: Assembly, rng: Generator) -> None:
    """An umbrella or parasol, open or folded. Segments: 1 the canopy, 2 ribs, shaft and handle."""
    folded = rng.random() < 0.25
    ribs = int(rng.choice([6, 8, 8, 10]))
    long = rng.uniform(1.35, 1.7)
    if folded:
        _folded_canopy(a, rng, ribs, long)
    else:
        wide = rng.uniform(0.75, 1.05)
        _open_canopy(a, rng, ribs, wide, wide * rng.uniform(0.3, 0.75))
    a.add("shaft", rod([0, 0, -long], [0, 0, 0.14], 0.028, around=14), TRIM)
    a.add("tip", rod([0, 0, 0.1], [0, 0, 0.24], 0.035, 0.012, bevel=1.0), TRIM)
    _handle(a, rng, long)
    # upright, leaning, or on the floor on rim and handle
    lean = float(rng.choice([0.0, rng.uniform(0.3, 0.7), rng.uniform(1.4, 2.2)], p=[0.4, 0.3, 0.3]))
    a.turn("y", -lean)
    a.turn("z", rng.uniform(0, 2 * np.pi))


def _open_canopy(a, rng, ribs, wide, deep):
    """A sheet that hangs between its ribs, as deep as `deep` at the rim."""
    around, sag, cut = ribs * 12, rng.uniform(0.02, 0.07), rng.uniform(0.03, 0.1)
    angle = np.linspace(0, 2 * np.pi, around, endpoint=False)
    between = np.sin(0.5 * ribs * angle) ** 2  # 0 on a rib, 1 in the middle between two
    steep = rng.uniform(1.6, 2.6)

    def rings(thickness: float) -> list[np.ndarray]:
        result = []
        for t in np.linspace(0.03, 1, 22):
            radius = wide * t * (1 - cut * between * t**3)
            z = -deep * t**steep - sag * between * t - thickness
            flat = np.stack([np.cos(angle), np.sin(angle)], 1) * radius[:, None]
            result.append(np.column_stack([flat, z]))
        return result

    a.add("canopy", loft([*rings(0.0), *rings(0.02)[::-1]]), MATERIAL)
    runner = -deep * rng.uniform(0.9, 1.2)
    t = np.linspace(0, 1, 14)
    line = np.stack([wide * t, 0 * t, -deep * t**steep - 0.03], 1)
    middle = line[8]
    for number in range(ribs):
        turn = 2 * np.pi * number / ribs
        a.add("rib", tube(line, 0.013, around=8).turned("z", turn), TRIM)
        a.add("stretcher", rod([0.03, 0, runner], middle, 0.011, around=8).turned("z", turn), TRIM)
    a.add("runner", rod([0, 0, runner - 0.08], [0, 0, runner + 0.04], 0.05, around=16), TRIM)


def _folded_canopy(a, rng, ribs, long):
    """Pleats about the shaft, wider towards the lower end or tied."""
    around = ribs * 16
    angle = np.linspace(0, 2 * np.pi, around, endpoint=False)
    pleat, tied = rng.uniform(0.15, 0.35), rng.random() < 0.5
    twist = rng.uniform(-0.8, 0.8)
    rings = []
    length = long * rng.uniform(0.55, 0.72)
    for t in np.linspace(0.02, 1, 40):
        radius = 0.04 + (0.13 if tied else 0.2) * t**0.7
        if tied:
            radius *= 1 - 0.35 * np.exp(-(((t - 0.6) / 0.07) ** 2))
        wavy = radius * (1 + pleat * t * np.cos(ribs * (angle + twist * t)))
        flat = np.stack([np.cos(angle), np.sin(angle)], 1) * wavy[:, None]
        rings.append(np.column_stack([flat, np.full(around, -length * t)]))
    rings.append(rings[-1] * [0.4, 0.4, 1.0] - [0, 0, 0.02])
    a.add("canopy", loft(rings), MATERIAL)


def _handle(a, rng, long):
    if rng.random() < 0.7:  # a crook
        size, arc = rng.uniform(0.11, 0.17), np.linspace(0, rng.uniform(2.9, 3.6), 16)
        bow = np.stack([size - size * np.cos(arc), 0 * arc, -long - 0.2 - size * np.sin(arc)], 1)
        path = np.vstack([[0, 0, -long + 0.02], [0, 0, -long - 0.1], bow])
        a.add("handle", tube(path, 0.05, around=18, bevel=1.0), TRIM)
    else:
        t = np.linspace(0, 1, 12)
        swell = 0.06 + 0.02 * np.sin(np.pi * t)
        path = np.stack([0 * t, 0 * t, -long - 0.3 * t], 1)
        a.add("handle", tube(path, swell, around=20, bevel=1.0), TRIM)
