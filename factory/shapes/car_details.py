"""Details of a car's body: lights, grille, mirrors, handles, bumpers, roof rails.

Metres, car axes (see car_body).
"""

import numpy as np

from factory.shapes.assembly import Assembly
from factory.shapes.car_body import DARK, PAINT, Form
from factory.shapes.closed_surface import LEFT_RIGHT, Surface, close_surface, grid_faces
from factory.shapes.curves import rounded_path
from factory.shapes.lofts import ellipsoid, rod, tube
from factory.shapes.rounded_boxes import rounded_box


def patch(
    form: Form, psi: tuple[float, float], theta: tuple[float, float], lift: float, count: int = 9
) -> Surface:
    """Return a pillow between two psi and two theta that follows the body's left skin.

    It is a closed Surface that stands out by `lift`.
    """
    grid_psi, grid_theta = np.meshgrid(
        np.linspace(*psi, count), np.linspace(*theta, count), indexing="ij"
    )
    skin = form.skin(grid_psi, grid_theta, cut=False)
    normal = np.cross(np.gradient(skin, axis=0), np.gradient(skin, axis=1))
    normal /= np.linalg.norm(normal, axis=2, keepdims=True)
    normal *= np.sign((normal[..., 1:2] * 1.0).sum())
    s = np.linspace(-1, 1, count)
    dome = ((1 - s[:, None] ** 6) * (1 - s[None, :] ** 6)) ** 0.5
    outer = skin + normal * (lift * dome - 0.004)[..., None]
    inner = skin - normal * 0.03
    faces = grid_faces(count, count)
    rim = np.concatenate(
        [
            np.arange(count - 1),
            np.arange(count - 1) * count + count - 1,
            count * count - 1 - np.arange(count - 1),
            (np.arange(count - 1, 0, -1)) * count,
        ]
    )
    ahead, size = np.roll(rim, -1), count * count
    wall = np.concatenate(
        [np.stack([rim, ahead, ahead + size], 1), np.stack([rim, ahead + size, rim + size], 1)]
    )
    return close_surface(
        np.concatenate([outer.reshape(-1, 3), inner.reshape(-1, 3)]),
        np.concatenate([faces, (faces + size)[:, ::-1], wall]),
    )


def lights(a: Assembly, rng: np.random.Generator, form: Form) -> None:
    """Add head and tail lights: wrapped round the corner, round, or upright."""
    kind = rng.choice(["wrapped", "slim", "round", "upright"])
    half = form.length / 2
    if kind == "round":
        size = rng.uniform(0.17, 0.22)
        y = form.width / 2 * rng.uniform(0.66, 0.74)
        x = _nose_x(form, y)
        z = form.nose - rng.uniform(0.11, 0.16)
        a.pair("head light", ellipsoid([0.12, size, size], 2.0, 24).moved(x - 0.02, y, z), DARK)
        ring = np.linspace(0, 2 * np.pi, 32, endpoint=False)
        a.pair(
            "light ring",
            tube(
                np.stack(
                    [
                        0 * ring + x + 0.0,
                        y + size * 0.52 * np.cos(ring),
                        z + size * 0.52 * np.sin(ring),
                    ],
                    1,
                ),
                0.014,
                10,
                ring=True,
            ),
            PAINT,
        )
    else:
        low = {"wrapped": 0.28, "slim": 0.42, "upright": 0.12}[kind]
        high = {"wrapped": 0.66, "slim": 0.66, "upright": 0.66}[kind]
        psi = (rng.uniform(0.6, 0.72), rng.uniform(1.0, 1.16)) if kind != "upright" else (0.78, 1.0)
        a.pair("head light", patch(form, psi, (low, high), 0.012), DARK)
    if kind == "round" and form.tail < 1.2:
        z = form.tail - rng.uniform(0.17, 0.22)
        y = form.width / 2 * 0.72
        a.pair(
            "tail light", ellipsoid([0.1, 0.16, 0.16]).moved(-_nose_x(form, y) + 0.02, y, z), DARK
        )
    else:
        psi = (-rng.uniform(0.95, 1.2), -rng.uniform(0.62, 0.75))
        a.pair(
            "tail light",
            patch(
                form,
                psi,
                (0.1, 0.62) if kind == "upright" else (rng.uniform(0.2, 0.35), 0.66),
                0.012,
            ),
            DARK,
        )
    a.add(
        "number plate",
        rounded_box([0.02, 0.5, 0.11], 0.008, edge=2).moved(
            -half + 0.005, 0, form.lower(-half) + 0.33
        ),
        DARK,
    )


def _nose_x(form, y):
    """Return x of the nose at |y|, from the plan."""
    share = min(abs(y) / (form.width / 2 * 0.955), 0.999)
    return form.length / 2 * (1 - share**form.corner) ** (1 / form.corner)


def front(a: Assembly, rng: np.random.Generator, form: Form) -> None:
    """Add grille, lower intake, and bumpers where they stand out."""
    half, bottom = form.length / 2, form.lower(form.length / 2)
    height = form.nose - bottom
    kind, middle = rng.choice(["bars", "plain", "twin", "tall", "none"]), bottom + height * 0.66
    wide, high = form.width * rng.uniform(0.36, 0.5), height * rng.uniform(0.14, 0.26)
    if kind in ("bars", "plain", "tall"):
        if kind == "tall":
            wide, high, middle = wide * 0.8, height * 0.46, bottom + height * 0.52
        a.add(
            "grille",
            rounded_box([0.05, wide, high], 0.02, edge=2).moved(half - 0.022, 0, middle),
            DARK,
        )
        for z in np.linspace(-0.4, 0.4, int(rng.integers(3, 6))) if kind != "plain" else ():
            a.add(
                "grille bar",
                rod(
                    [half + 0.004, -wide * 0.46, middle + z * high],
                    [half + 0.004, wide * 0.46, middle + z * high],
                    0.008,
                    around=8,
                ),
                PAINT,
            )
    elif kind == "twin":
        a.pair(
            "grille",
            rounded_box([0.05, wide * 0.42, high], 0.03).moved(half - 0.022, wide * 0.26, middle),
            DARK,
        )
    a.add(
        "intake",
        rounded_box(
            [0.06, form.width * rng.uniform(0.45, 0.62), height * rng.uniform(0.12, 0.2)],
            0.025,
            edge=2,
        ).moved(half - 0.03, 0, bottom + height * 0.2),
        DARK,
    )
    if rng.random() < (0.75 if form.bed else 0.3):
        for end in (1, -1):
            axle = form.axles[0 if end > 0 else 1]
            start = max(0.55, abs(float(form.psi_at(axle + end * (form.arch + 0.06)))))
            psi = end * np.linspace(start, np.pi - start, 33)
            t, plan = form.plan(psi)
            z = form.lower(half) + height * 0.38
            path = np.stack(
                [t * half + end * 0.012, plan * form.width / 2 * 0.97, np.full(33, z)], 1
            )
            a.add(
                "bumper",
                tube(path, np.array([0.035, 0.065]), around=14, square=3.5, bevel=0.9),
                DARK if rng.random() < 0.5 else PAINT,
            )


def mirrors_and_handles(a: Assembly, rng: np.random.Generator, form: Form) -> None:
    """Add door mirrors on the belt and one or two handles per side."""
    z = float(form.upper(form.cowl_at)) + 0.06
    x, y = form.cowl_at - rng.uniform(0.32, 0.42), form.width / 2 + rng.uniform(-0.02, 0.02)
    size = rng.uniform(0.9, 1.15)
    a.pair(
        "mirror",
        ellipsoid([0.12 * size, 0.19 * size, 0.13 * size], 2.8, 16).moved(x, y + 0.02, z + 0.03),
        PAINT,
    )
    a.pair(
        "mirror arm",
        rod([x - 0.01, y - 0.14, z - 0.02], [x, y + 0.02, z + 0.01], 0.022, around=10),
        DARK,
    )
    doors = 1 if form.roof_front_at - form.roof_rear_at < 1.25 else 2
    for k in range(doors):
        x = form.roof_front_at - 0.55 - 0.92 * k
        z = float(form.upper(x)) - 0.16
        a.pair(
            "handle",
            ellipsoid([0.2, 0.045, 0.035], 3.0, 14).moved(x, form.side(x, z) + 0.006, z),
            PAINT,
        )


def seams(a: Assembly, form: Form) -> None:
    """Add the gaps of the doors and of the bonnet, as thin dark lines on the skin."""
    doors = 1 if form.roof_front_at - form.roof_rear_at < 1.25 else 2
    start = min(form.cowl_at + 0.02, form.axles[0] - form.arch - 0.04)
    stop = max(form.axles[1] + form.arch * 0.75, start - (1.25 if doors == 1 else 2.2))
    for x in np.linspace(start, stop, doors + 1):
        skin = form.skin(form.psi_at(x), np.linspace(-0.75, 1.1, 16))
        a.pair("seam", tube(skin, 0.007, around=5), DARK)
    theta = np.linspace(0.9, np.pi / 2, 9)[:-1]
    across = form.skin(form.psi_at(form.length / 2 - 0.2), theta)
    a.add(
        "seam", tube(np.concatenate([across, (across * [1, -1, 1])[::-1]]), 0.007, around=5), DARK
    )


def cockpit(a: Assembly, rng: np.random.Generator, form: Form) -> None:
    """Add the inside of an open car: windscreen, two seats, steering wheel, perhaps hoops."""
    x, z = form.cowl_at, float(form.upper(form.cowl_at))
    wide, tall, rake = form.width / 2 - 0.14, rng.uniform(0.32, 0.42), rng.uniform(0.45, 0.7)
    y = np.linspace(-1, 1, 17)
    foot = np.stack([x - 0.16 * y**4 - 0.05 * y**2, wide * y, 0 * y + z - 0.03], 1)
    half = np.stack([np.full(17, 0.012), np.full(17, tall / 2)], 1)
    middle = foot + np.array([-rake * tall / 2, 0, tall / 2])
    a.add("windscreen", tube(middle, half, around=16, square=5.0, side=(1.0, 0, rake)), DARK)
    rear, low = form.glass_rear_at, form.lower(0) + 0.12
    seat_x = max(rear + 0.2, 0.5 * (x + rear) - 0.25)
    for k in LEFT_RIGHT:
        a.add(
            "seat",
            rounded_box([0.16, 0.48, z + 0.12 - low], 0.06, (0.1, 0.05, 0), inner=4)
            .turned("y", -0.2)
            .moved(seat_x, k * 0.34, (z + 0.12 + low) / 2),
            DARK,
        )
    ring = np.linspace(0, 2 * np.pi, 28, endpoint=False)
    wheel = np.stack([0.35 * 0.18 * np.sin(ring), 0.18 * np.cos(ring), 0.18 * np.sin(ring)], 1)
    a.add(
        "steering wheel",
        tube(wheel + np.array([x - 0.42, 0.34, z - 0.02]), 0.014, around=8, ring=True),
        DARK,
    )
    if rng.random() < 0.5:
        for k in LEFT_RIGHT:
            hoop = rounded_path(
                [
                    [seat_x - 0.2, k * 0.34 - 0.17, z - 0.15],
                    [seat_x - 0.22, k * 0.34 - 0.17, z + 0.26],
                    [seat_x - 0.22, k * 0.34 + 0.17, z + 0.26],
                    [seat_x - 0.2, k * 0.34 + 0.17, z - 0.15],
                ],
                0.12,
            )
            a.add("hoop", tube(hoop, 0.022, around=10), PAINT)


def roof_details(a: Assembly, rng: np.random.Generator, form: Form, kind: str) -> None:
    """Add rails, a spoiler, or a wing; add exhaust pipes."""
    if kind in ("suv", "wagon", "van") and rng.random() < 0.6:
        y, z = form.width / 2 - 0.16 - form.tumblehome, form.height - 0.02
        ends = form.roof_front_at - 0.3, form.roof_rear_at + 0.35
        path = rounded_path(
            [
                [ends[0], y, z - 0.03],
                [ends[0] - 0.15, y, z + 0.045],
                [ends[1] + 0.15, y, z + 0.04],
                [ends[1], y, z - 0.05],
            ],
            0.15,
        )
        a.pair("rail", tube(path, 0.018, around=10), DARK)
    if kind in ("hatch", "suv", "wagon") and rng.random() < 0.6:
        wide = 1.7 * (form.width / 2 - 0.085 - form.tumblehome)
        wing = rounded_box([0.3, wide, 0.04], 0.018, (0.12, 0, 0), inner=4).turned("y", -0.07)
        a.add("spoiler", wing.moved(form.roof_rear_at + 0.03, 0, form.height - 0.075), PAINT)
    if kind in ("coupe", "sedan") and rng.random() < 0.25:
        x, z = -form.length / 2 + 0.3, form.tail + rng.uniform(0.06, 0.13)
        a.add(
            "wing",
            rounded_box([0.2, form.width * 0.76, 0.03], 0.014).turned("y", 0.08).moved(x, 0, z),
            PAINT,
        )
        a.pair(
            "wing post",
            rod([x, form.width * 0.26, form.tail - 0.06], [x, form.width * 0.26, z], [0.012, 0.05]),
            PAINT,
        )
    if rng.random() < 0.3:
        for k in LEFT_RIGHT:
            pipe = rod(
                [-form.length / 2 + 0.2, k * 0.5, form.lower(-form.length / 2) + 0.06],
                [-form.length / 2 - 0.03, k * 0.5, form.lower(-form.length / 2) + 0.06],
                0.036,
                around=14,
                bevel=0.1,
            )
            a.add("exhaust", pipe, DARK)
