"""What stands about a house, made of parts: lamps, tables and stools, tools, toys."""

import numpy as np

from factory.shapes.assembly import Assembly
from factory.shapes.closed_surface import LEFT_RIGHT
from factory.shapes.curves import smooth_path, superellipse
from factory.shapes.general import fields
from factory.shapes.general.draws import Generator, log_uniform, profile, round_outline
from factory.shapes.general.isosurface import surface_of
from factory.shapes.lofts import ellipsoid, revolve, rod, slab, tube
from factory.shapes.rounded_boxes import rounded_box


def lamp(a: Assembly, rng: Generator) -> None:
    """A table, floor or desk lamp: a base, a stem that may be jointed, a shade. Segments: 1 the
    shade, 2 the rest.
    """
    kind = rng.choice(["table", "floor", "desk", "globe"], p=[0.4, 0.2, 0.25, 0.15])
    base = rng.uniform(0.25, 0.5)
    if kind == "table" and rng.random() < 0.6:
        height = rng.uniform(0.5, 0.9)
        body = profile(rng, height) * [0.7, 1.0]
        a.add("base", revolve(np.vstack([[0, 0], body, [0, height]]), 64), 2)
        top = np.array([0.0, 0.0, height + 0.15])
        a.add("stem", rod([0, 0, height - 0.05], top, 0.03), 2)
    else:
        thick = rng.uniform(0.04, 0.1)
        a.add("base", slab(superellipse(64, rng.choice([2.0, 6.0])) * base, thick, 0.6), 2)
        height = 2.2 if kind == "floor" else rng.uniform(0.7, 1.3)
        if kind == "desk":
            lean = rng.uniform(0.15, 0.45)
            elbow = np.array([-lean, 0, height * rng.uniform(0.5, 0.75)])
            top = np.array([rng.uniform(0.2, 0.7), 0, height])
            a.add("arm", rod([0, 0, 0], elbow, 0.03), 2)
            a.add("arm", rod(elbow, top, 0.03), 2)
            a.add("joint", ellipsoid([0.12, 0.1, 0.12]).moved(*elbow), 2)
        else:
            top = np.array([0.0, 0.0, height])
            a.add("stem", rod([0, 0, 0], top, rng.uniform(0.025, 0.06)), 2)
    _shade(a, rng, top, kind)


def _shade(a, rng, top, kind):
    low, high, tall = rng.uniform(0.35, 0.65), rng.uniform(0.15, 0.5), rng.uniform(0.35, 0.7)
    if kind == "globe":
        size = rng.uniform(0.5, 0.9)
        a.add(
            "shade", ellipsoid([size, size, size * rng.uniform(0.7, 1.1)], around=48).moved(*top), 1
        )
        return
    wall, bow = 0.03, rng.uniform(-0.1, 0.15)
    t = np.linspace(0, 1, 24)
    radius = low + (high - low) * t + bow * np.sin(np.pi * t)
    outer = np.stack([radius, tall * (t - 0.6)], 1)
    inner = outer[::-1] - [wall, 0]
    lid = np.array([[0.0, outer[-1, 1] - wall], [0.0, outer[-1, 1]]])
    if rng.random() < 0.5 or kind == "desk":  # closed above
        inner[0, 1] -= wall
        section = np.vstack([lid[:1], inner, outer, lid[1:]])
        shade = revolve(section, 64)
    else:
        from factory.shapes.general.vessels import turned_ring

        shade = turned_ring(np.vstack([inner, outer]))
        a.add(
            "spokes", rod([-high, 0, outer[-1, 1]], [high, 0, outer[-1, 1]], 0.015).moved(*top), 2
        )
    if kind == "desk":
        shade = shade.turned("y", -rng.uniform(0.2, 0.9))
    a.add("shade", shade.moved(*top), 1)


def table(a: Assembly, rng: Generator) -> None:
    """A table, desk, stool, bench or shelf. Segments: 1 tops and boards, 2 legs."""
    kind = rng.choice(["legs", "pedestal", "sides", "shelf"], p=[0.5, 0.2, 0.15, 0.15])
    width = rng.uniform(0.5, 1.4)
    depth = width * rng.uniform(0.5, 1.0)
    height = log_uniform(rng, 0.35, 1.3)
    thick = rng.uniform(0.04, 0.1)
    square = rng.choice([2.0, 4.0, 12.0], p=[0.35, 0.15, 0.5])
    outline = superellipse(72, square) * [depth / 2, width / 2]
    if rng.random() < 0.1:
        outline = round_outline(rng, 0.25, 96) * [depth / 2, width / 2]
    top = slab(outline, thick, rng.uniform(0.2, 0.9)).moved(z=height)
    if kind == "shelf":
        return _shelf(a, rng, width, depth, height * 1.5)
    a.add("top", top, 1)
    inset = 0.68 if square < 3 else 0.88
    x, y = inset * depth / 2, inset * width / 2
    if kind == "pedestal":
        turned_leg = profile(rng, height) * [0.25, 1.0]
        a.add("pedestal", revolve(np.vstack([[0, 0], turned_leg, [0, height]]), 48), 2)
        feet = int(rng.integers(3, 6))
        for number in range(feet):
            angle = 2 * np.pi * number / feet
            end = np.array([x * np.cos(angle), x * np.sin(angle), 0.02])
            a.add("foot", rod([0, 0, 0.12], end, 0.05, 0.035), 2)
        return
    if kind == "sides":
        for s in LEFT_RIGHT:
            board = rounded_box([depth * 0.9, 0.07, height], 0.02).moved(0, s * y, height / 2)
            a.add("side", board, 2)
        return
    splay, size = rng.uniform(0, 0.15), rng.uniform(0.03, 0.07)
    section = float(rng.choice([2.0, 8.0]))
    for front in LEFT_RIGHT:
        for s in LEFT_RIGHT:
            foot = [front * (x + splay), s * (y + splay), 0.0]
            leg = rod(
                [front * x, s * y, height], foot, size, size * rng.uniform(0.5, 1), square=section
            )
            a.add("leg", leg, 2)
    if rng.random() < 0.4:
        apron = rounded_box([2 * x, 2 * y, 0.12], 0.01).moved(z=height - 0.1)
        a.add("apron", apron, 2)
    if rng.random() < 0.3:
        level = height * rng.uniform(0.2, 0.4)
        a.add("shelf", rounded_box([2 * x, 2 * y, 0.04], 0.015).moved(z=level), 1)


def _shelf(a, rng, width, depth, height):
    depth = min(depth, 0.5)
    for s in LEFT_RIGHT:
        a.add(
            "side", rounded_box([depth, 0.05, height], 0.015).moved(0, s * width / 2, height / 2), 2
        )
    for level in np.linspace(0.04, height - 0.02, int(rng.integers(3, 6))):
        a.add("board", rounded_box([depth, width, 0.045], 0.012).moved(z=float(level)), 1)
    if rng.random() < 0.7:
        a.add("back", rounded_box([0.03, width, height], 0.01).moved(-depth / 2, 0, height / 2), 2)


def tool(a: Assembly, rng: Generator) -> None:
    """A hammer, spanner, screwdriver, brush, spoon or bulb. Segments: 1 the head, 2 the handle."""
    kind = str(rng.choice(["hammer", "spanner", "screwdriver", "brush", "spoon", "bulb"]))
    length = rng.uniform(1.2, 1.9)
    if kind == "spanner":
        return _spanner(a, rng, length)
    if kind == "bulb":
        return _bulb(a, rng)
    thick = rng.uniform(0.05, 0.11)
    t = np.linspace(0, 1, 24)
    swell = thick * (1 + rng.uniform(0, 0.5) * np.sin(2.5 * np.pi * t) * (1 - t))
    line = np.stack([0 * t, 0.03 * np.sin(np.pi * t), length * t], 1)
    sizes = np.stack([swell, swell * rng.uniform(0.6, 1.0)], 1)
    a.add("handle", tube(line, sizes, around=24, square=rng.choice([2.0, 4.0]), bevel=0.8), 2)
    top = [0.0, 0.0, length]
    if kind == "hammer":
        head = fields.union(
            [
                fields.moved(fields.box((0.16, 0.14, 0.14), 0.04), (0, 0, 0)),
                fields.capsule((0.1, 0, 0), (0.35, 0, 0), 0.12, rng.uniform(0.12, 0.17)),
                fields.capsule((-0.1, 0, 0), (-0.5, 0, -0.08), 0.1, 0.03),
            ],
            0.06,
        )
        face = fields.half_space((1, 0, 0), 0.38)
        a.add("head", surface_of(fields.intersection([head, face], 0.03), 0.75, 96).moved(*top), 1)
    elif kind == "screwdriver":
        a.add("shaft", rod(top, [0, 0, length * 1.7], 0.035), 1)
        a.add("tip", rounded_box([0.02, 0.09, 0.12], 0.008).moved(0, 0, length * 1.7), 1)
    elif kind == "brush":
        a.add("ferrule", rounded_box([0.16, 0.4, 0.2], 0.03).moved(0, 0, length + 0.05), 1)
        a.add(
            "bristles",
            rounded_box([0.13, 0.38, 0.4], 0.05, (0, 0, 0.1)).moved(0, 0, length + 0.3),
            1,
        )
    else:
        half = np.array([0.1, rng.uniform(0.2, 0.32), rng.uniform(0.3, 0.45)])
        bowl = fields.cut(
            fields.ellipsoid(half),
            [
                fields.moved(fields.ellipsoid(half * 0.86), (0.06, 0, 0)),
                fields.half_space((-1, 0, 0), -0.02),
            ],
            0.02,
        )
        a.add("bowl", surface_of(bowl, 0.6, 96).moved(0, 0, length + half[2] * 0.9), 1)


def _spanner(a, rng, length):
    size, thick = rng.uniform(0.22, 0.32), rng.uniform(0.06, 0.1)
    end = fields.cylinder(size, thick, 0.03)
    hexagon = [np.array([np.cos(t), np.sin(t)]) * size * 0.58 for t in np.arange(6) * np.pi / 3]
    outline = fields.Outline([np.array(hexagon)])
    jaw = fields.box((size * 0.9, size * 0.42, 1.0), 0.01)
    shaft = fields.box((length / 2, size * 0.38, thick * 0.7), 0.03)

    def hole(p: np.ndarray) -> np.ndarray:
        return outline(p[..., 0] + length / 2, p[..., 1])

    field = fields.union(
        [shaft, *(fields.moved(end, (s * length / 2, 0, 0)) for s in (1, -1))], 0.06
    )
    field = fields.cut(field, [fields.moved(jaw, (length / 2 + size * 0.7, 0, 0)), hole], 0.01)
    a.add("spanner", surface_of(field, length / 2 + 0.5).turned("y", rng.uniform(0, 1.4)), 1)


def _bulb(a, rng):
    t = np.linspace(0, 1, 40)
    wide = rng.uniform(0.35, 0.5)
    radius = 0.16 + (wide - 0.16) * np.sin(np.pi * np.clip(t * 1.15 - 0.1, 0, 1)) ** 1.5
    radius[-8:] = np.sqrt(np.clip(1 - np.linspace(0, 1, 8) ** 2, 0, 1)) * radius[-8]
    glass = np.stack([radius, 0.35 + 0.9 * t], 1)
    a.add("glass", revolve(np.vstack([[0, 0.35], glass]), 64), 1)
    threads = np.linspace(0, 5 * 2 * np.pi, 64)
    z = np.linspace(0.05, 0.35, 64)
    cap = 0.15 + 0.012 * np.cos(threads)
    a.add("cap", revolve(np.vstack([[0, 0], [0.07, 0.0], np.stack([cap, z], 1), [0, 0.36]]), 48), 2)


def toy(a: Assembly, rng: Generator) -> None:
    """An animal, duck, robot, rocket or stack of rings. Segments: 1 the body, 2 the rest."""
    kind = rng.choice(["animal", "duck", "robot", "rocket", "rings"], p=[0.4, 0.15, 0.2, 0.15, 0.1])
    {"animal": _animal, "duck": _duck, "robot": _robot, "rocket": _rocket, "rings": _rings}[
        str(kind)
    ](a, rng)


def _animal(a, rng):
    """A quadruped that stands or sits: body, legs, head, ears and tail, blended."""
    long, tall, wide = rng.uniform(0.35, 0.7), rng.uniform(0.22, 0.4), rng.uniform(0.2, 0.38)
    leg, thick = rng.uniform(0.25, 0.8), rng.uniform(0.07, 0.14)
    head = np.array([long + rng.uniform(0.0, 0.3), 0.0, leg + rng.uniform(0.2, 0.8)])
    size = rng.uniform(0.2, 0.34)
    body = fields.moved(fields.ellipsoid((long, wide, tall)), (0, 0, leg))
    parts = [
        body,
        fields.capsule((long * 0.6, 0, leg + 0.1), head, tall * 0.55, size * 0.6),
        fields.moved(fields.ellipsoid((size * 1.1, size * 0.9, size)), head),
        fields.capsule(
            head,
            np.add(head, (size * rng.uniform(0.9, 1.6), 0, -0.25 * size)),
            size * 0.6,
            size * 0.4,
        ),
        fields.capsule(
            (-long * 0.9, 0, leg),
            (-long - rng.uniform(0.1, 0.5), 0, leg + rng.uniform(-0.2, 0.6)),
            0.07,
            0.04,
        ),
    ]
    step = rng.uniform(-0.15, 0.15)
    for x in (0.6 * long, -0.6 * long):
        foot = (x + step, 0.6 * wide + 0.03, 0)
        parts.append(fields.capsule((x, 0.55 * wide, leg * 0.9), foot, thick * 1.2, thick * 0.8))
    ear = np.add(head, (-0.1 * size, 0.55 * size, 0.8 * size))
    point = np.add(ear, (0, rng.uniform(0, 0.2), rng.uniform(0.1, 0.6)))
    parts.append(fields.capsule(ear, point, 0.09, rng.uniform(0.03, 0.09)))
    field = fields.mirrored(fields.union(parts, rng.uniform(0.04, 0.14)))
    centre = (0.0, 0.0, 0.5 * (head[2] + size))
    a.add("body", surface_of(fields.moved(field, -np.array(centre)), 1.9), 1)


def _duck(a, rng):
    size = rng.uniform(0.3, 0.42)
    head = np.array([0.45, 0.0, rng.uniform(0.55, 0.75)])
    parts = [
        fields.ellipsoid((0.8, 0.55, 0.45)),
        fields.capsule((-0.5, 0, 0.1), (-0.95, 0, rng.uniform(0.25, 0.5)), 0.25, 0.06),
        fields.capsule((0.4, 0, 0.2), head, 0.25, size * 0.7),
        fields.moved(fields.ellipsoid([size] * 3), head),
        fields.moved(fields.ellipsoid((0.45, 0.12, 0.25)), (-0.1, 0.52, 0.1)),
    ]
    field = fields.mirrored(fields.union(parts, rng.uniform(0.05, 0.15)))
    a.add("body", surface_of(fields.moved(field, (0, 0, -0.3)), 1.5).moved(z=0.3), 1)
    beak = ellipsoid([0.36, 0.3, 0.12]).moved(head[0] + size + 0.05, 0, head[2] - 0.05)
    a.add("beak", beak, 2)


def _robot(a, rng):
    w, d, h = rng.uniform(0.4, 0.7), rng.uniform(0.3, 0.5), rng.uniform(0.5, 0.8)
    leg = rng.uniform(0.3, 0.6)
    edge = rng.uniform(0.02, 0.12)
    a.add("body", rounded_box([d, w, h], edge, edge=4).moved(z=leg + h / 2), 1)
    head = rng.uniform(0.25, 0.45)
    top = leg + h + 0.05
    if rng.random() < 0.5:
        a.add(
            "head", rounded_box([head, head * 1.2, head], edge, edge=4).moved(z=top + head / 2), 1
        )
    else:
        a.add("head", ellipsoid([head * 1.2] * 3, around=40).moved(z=top + head / 2), 1)
    a.add("neck", rod([0, 0, top - 0.1], [0, 0, top + 0.1], 0.07), 2)
    lift = rng.uniform(-1.2, 1.0)
    for s in LEFT_RIGHT:
        shoulder = np.array([0, s * (w / 2 + 0.02), leg + h * 0.85])
        hand = np.add(shoulder, (0.2, s * 0.3, 0.45 * np.sin(lift)))
        a.add("arm", rod(shoulder, hand, 0.07, 0.06, bevel=1.0), 2)
        a.add("hand", ellipsoid([0.2, 0.2, 0.2]).moved(*hand), 1)
        a.add("leg", rod([0, s * w / 4, leg + 0.05], [0, s * w / 4, 0.05], 0.09), 2)
        a.add("foot", rounded_box([0.35, 0.2, 0.12], 0.04).moved(0.06, s * w / 4, 0.06), 1)
        eye = ellipsoid([0.08] * 3).moved(head * 0.52, s * head * 0.25, top + head * 0.6)
        a.add("eye", eye, 2)


def _rocket(a, rng):
    t = np.linspace(0, 1, 48)
    wide = rng.uniform(0.25, 0.4)
    radius = wide * np.clip(np.sin(np.pi * (0.18 + 0.82 * t)), 0, 1) ** rng.uniform(0.5, 0.9)
    radius[-1] = 0.0
    hull = np.vstack([[0, 0], np.stack([radius, 1.7 * t], 1)])
    a.add("hull", revolve(hull, 64), 1)
    fins = int(rng.integers(3, 5))
    spread = rng.uniform(0.25, 0.45)
    for number in range(fins):
        path = smooth_path(
            [[wide * 0.4, 0, 0.7], [wide + spread * 0.7, 0, 0.3], [wide + spread, 0, -0.2]], 12
        )
        sizes = np.stack([np.full(12, 0.035), np.linspace(0.22, 0.08, 12)], 1)
        fin = tube(path, sizes, around=20, square=4.0, bevel=0.8)
        a.add("fin", fin.turned("z", 2 * np.pi * number / fins), 2)
    window = ellipsoid([0.12, 0.26, 0.26]).moved(wide * 0.93, 0, 1.0)
    a.add("window", window, 2)


def _rings(a, rng):
    z, size = 0.0, rng.uniform(0.55, 0.75)
    a.add("post", rod([0, 0, 0], [0, 0, 1.3], 0.1, 0.07, bevel=1.0), 2)
    a.add("base", slab(superellipse(64) * 0.6, 0.1, 0.8), 2)
    t = np.linspace(0, 2 * np.pi, 64, endpoint=False)
    for _ in range(int(rng.integers(3, 6))):
        thick = size * rng.uniform(0.18, 0.24)
        z += thick + 0.02
        ring = (size - thick) * np.stack([np.cos(t), np.sin(t), 0 * t], 1)
        a.add("ring", tube(ring, thick, around=28, ring=True).moved(z=z), 1)
        z += thick
        size *= rng.uniform(0.72, 0.88)
    a.add("ball", ellipsoid([0.34] * 3, around=32).moved(z=max(z, 1.2) + 0.14), 2)
