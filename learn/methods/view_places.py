"""Where pixels of a picture in perspective read reflectance maps, which hold one view per node.

In most pictures the view follows from the normal, but for a part: on a sphere entirely, on a flat
wall not at all. A map's nodes therefore have views of their own, V(n), a quadratic function of the
normal that is fitted to the picture. What remains of a pixel's view, its offset from V, is left to
a polynomial, whose coefficients are maps too, made of radiance for K views beside V:

    I(n, v) ≈ M(n') + Σ_j t_j(x) C_j(n'),  M(n) = I(n, V(n)),  C_j(n) = Σ_k a_jk I(n_k, V(n) + o_k)

x    the offset of v from V(n') in the plane of the views, in units of `half`
t_j  the terms x, y (K = 3), and x², xy, y² (K = 6)
a_jk such that the polynomial and a constant have the values I(n_k, V + o_k) at o_k. The constant is
     left out, for M is nearer to it, unless a derivative by the view is requested: the C_j are as
     fine as M then, and the constant serves in its place
n'   the place where the pixel reads, and n_k the normal of a node for view k. Broad lobes are read
     at the normal itself, n' = n and n_k = n. Sharp ones are read where the node mirrors the same
     light into V(n') as the pixel does into v, so that highlights stay where they are; n_k likewise

n, view (P, 3) float32 unit vectors, camera frame. Arrays of float64 are computed by numpy, against
which tests compare the kernels (learn/engines/view_places.py).
"""

import functools
import math

import numpy as np

from learn.engines import machine_code
from learn.methods import directional, reflectance_map

LEAST_DEPTH = 0.5  # of a view along their mean, 60° off it: beyond, no maps are made
LEAST_HALF = 0.05  # of the offsets: polynomials over less lose digits
# n·v below which a highlight is no longer moved in full; larger where V is so steep that a step
# towards a place would not bring it nearer by this factor
LEAST_COSINE, CONTRACTION = 0.2, 0.7
FITTED = 1024  # pixels to which V is fitted
STEPS, SETTLED = 8, 2e-4  # at most, to find a place, and the mean change at which it is found
LEFT = 0.02  # of a derivative, that the series for V's part in a place may leave out
PLACED = 3e-8  # seconds for each pixel
RIDGE = 1e-3  # holds V where a picture's normals do not tell its terms apart


def ring(count: int, radius: float) -> list[tuple[float, float]]:
    """Points on a circle."""
    angles = (2 * math.pi * k / count for k in range(count))
    return [(radius * math.cos(angle), radius * math.sin(angle)) for angle in angles]


# offsets, from −1 to 1 in two directions, that fix a polynomial of degree 0, 1 or 2; three have the
# second moments of the square
OFFSETS = {1: [(0.0, 0.0)], 3: ring(3, math.sqrt(2 / 3)), 6: [(0.0, 0.0), *ring(5, 1.0)]}
# monomials x^a y^b, of which the first 1, 3 or 6 serve
POWERS = ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2))


@functools.cache
def coefficients(count: int) -> np.ndarray:
    """Return the a_jk of the polynomial's constant and of its terms, (K, K) float32."""
    x, y = np.array(OFFSETS[count]).T
    terms = np.stack([x**i * y**j for i, j in POWERS[:count]], -1)
    return np.linalg.inv(terms).astype(np.float32)


def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """a·b, (P, 1)."""
    return (a[:, :1] * b[:, :1] + a[:, 1:2] * b[:, 1:2]) + a[:, 2:] * b[:, 2:]


def component_along(vectors: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Return components (P,) of vectors (P, 3) along an axis, without BLAS, whose threads spin."""
    return vectors[:, 0] * axis[0] + vectors[:, 1] * axis[1] + vectors[:, 2] * axis[2]


def features(n: np.ndarray) -> list[np.ndarray]:
    """Return the terms (P,) of V, by normals (P, 3)."""
    x, y, z = n[:, 0], n[:, 1], n[:, 2]
    return [np.ones_like(x), x, y, z, x * z, y * z]


class Views:
    """The views of a picture as slopes in the plane across their mean, and V fitted to them.

    frame   (3, 3) two directions across the mean view, and the mean view
    slopes  (2, P) of the pixels' views
    fit     (2, 6) coefficients of V's slopes
    half    (2,) half the width of the offsets, as if they were spread evenly
    spread  the larger half width, as it is; infinite where no maps should be made
    steepness  half of V's slope by n: how much faster reflected directions turn, as a share
    least_cosine, terms  LEAST_COSINE for this fit, and terms of the series in `Places.backward`
    """

    def __init__(self, n: np.ndarray, view: np.ndarray):
        axis = view.sum(0, dtype=np.float64)
        axis /= np.linalg.norm(axis) or 1.0
        e1 = np.cross([0.0, 1.0, 0.0] if abs(axis[1]) < 0.9 else [1.0, 0.0, 0.0], axis)
        e1 /= np.linalg.norm(e1)
        self.frame = np.stack([e1, np.cross(axis, e1), axis]).astype(np.float32)
        a, b, depth = (component_along(view, row) for row in self.frame)
        self.depth = np.maximum(depth, np.float32(LEAST_DEPTH))
        self.slopes = np.stack([a / self.depth, b / self.depth])
        pick = directional.spread_indices(len(n), FITTED)
        self.fit = np.ascontiguousarray(fit_views(n[pick], self.slopes[:, pick]))
        offsets = self.slopes[:, pick] - self.middle(n[pick])
        wide = np.sqrt(3 * np.square(offsets).mean(1))
        self.half = np.maximum(wide, np.float32(LEAST_HALF))
        # half of dV/dn, in the mean over directions and most pixels: a step towards a place changes
        # the next by that over n·v
        (_, a1, a2, a3, a4, a5), (_, b1, b2, b3, b4, b5) = self.fit
        x, y, z = n[pick].T
        by_x = np.square(a1 + a4 * z) + np.square(b1 + b4 * z)
        by_y = np.square(a2 + a5 * z) + np.square(b2 + b5 * z)
        by_z = np.square(a3 + a4 * x + a5 * y) + np.square(b3 + b4 * x + b5 * y)
        steep = np.sqrt(0.5 * (by_x + by_y + by_z))
        self.steepness = 0.5 * float(np.quantile(steep, 0.9)) + 1e-9
        self.least_cosine = max(LEAST_COSINE, self.steepness / CONTRACTION)
        contraction = min(2 * self.steepness, CONTRACTION)
        self.terms = max(math.ceil(math.log(LEFT) / math.log(contraction)), 1)
        self.spread = float(wide.max()) if float(depth.min()) > LEAST_DEPTH else math.inf

    def middle(self, n: np.ndarray) -> np.ndarray:
        """Return slopes (2, P) of V."""
        terms = features(n)
        return np.stack(
            [sum(c * term for c, term in zip(row, terms, strict=True)) for row in self.fit]
        )

    def middle_backward(self, n: np.ndarray, by_slopes: np.ndarray) -> np.ndarray:
        """Return the derivative by n (P, 3), from those by V's slopes (2, P)."""
        x, y, z = n[:, 0], n[:, 1], n[:, 2]
        result = np.zeros_like(n)
        for (_, c1, c2, c3, c4, c5), g in zip(self.fit, by_slopes, strict=True):
            result[:, 0] += g * (c1 + c4 * z)
            result[:, 1] += g * (c2 + c5 * z)
            result[:, 2] += g * (c3 + c4 * x + c5 * y)
        return result

    def vectors(self, slopes: np.ndarray) -> np.ndarray:
        """Return unit vectors (P, 3) of slopes (2, P)."""
        e1, e2, axis = self.frame
        result = slopes[0][:, None] * e1 + slopes[1][:, None] * e2 + axis
        return result / np.sqrt(1 + slopes[0] ** 2 + slopes[1] ** 2)[:, None]

    def vectors_backward(self, slopes: np.ndarray, by_vectors: np.ndarray) -> np.ndarray:
        """Return derivatives (2, P) by slopes, from the one by `vectors`."""
        length = np.sqrt(1 + slopes[0] ** 2 + slopes[1] ** 2)
        e1, e2, _ = self.frame
        radial = dot(by_vectors, self.vectors(slopes))[:, 0] / length
        return np.stack(
            [
                (component_along(by_vectors, e) - radial * slope) / length
                for e, slope in zip((e1, e2), slopes, strict=True)
            ]
        )

    def slopes_backward(self, by_slopes: np.ndarray) -> np.ndarray:
        """Return the derivative by view (P, 3), from the one by the pixels' slopes (2, P)."""
        e1, e2, axis = self.frame
        by_a, by_b = by_slopes / self.depth
        by_depth = -(by_a * self.slopes[0] + by_b * self.slopes[1])
        return by_a[:, None] * e1 + by_b[:, None] * e2 + by_depth[:, None] * axis

    def beside(self, n: np.ndarray, count: int, mirrored: bool) -> tuple[np.ndarray, np.ndarray]:
        """Return normals n_k and views V + o_k, each (K, P, 3), of map places n (P, 3)."""
        middle = self.middle(n)
        view = self.vectors(middle)
        half = self.half[:, None]
        views = [
            self.vectors((middle + half * np.array(o, np.float32)[:, None]).astype(np.float32))
            for o in OFFSETS[count]
        ]
        least = self.least_cosine
        normals = [move_normals(n, view, other, least)[0] if mirrored else n for other in views]
        return np.stack(normals), np.stack(views)


def fit_views(n: np.ndarray, slopes: np.ndarray) -> np.ndarray:
    """Return coefficients (2, 6) float32 of V by least squares."""
    terms = np.stack(features(n.astype(np.float64)))
    # einsum, for BLAS has threads that spin
    gram = np.einsum("ip,jp->ij", terms, terms)
    right = np.einsum("kp,ip->ki", slopes.astype(np.float64), terms)
    gram[1:, 1:] += RIDGE * len(n) * np.eye(len(terms) - 1)
    return np.linalg.solve(gram, right.T).T.astype(np.float32)


def move_normals(
    n: np.ndarray, view: np.ndarray, other: np.ndarray, least_cosine: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the normal (P, 3) that mirrors into `other` what n mirrors into the view; its steps.

    With r = 2 (n·v) n − v it is (r + other)/‖r + other‖. Where n·v < least_cosine, it moves as if
    n·v were that.
    Returns  the normal, ‖r + other‖ (P, 1), and n·v or least_cosine (P, 1)
    """
    cosine = np.maximum(dot(n, view), np.float32(least_cosine))
    u = 2 * cosine * n + (other - view)
    length = np.sqrt(dot(u, u))
    return u / length, length, cosine


class Places:
    """Where the pixels read maps, and their offsets from V there.

    n             (P, 3) places n'
    coordinates   (2, P) x
    """

    def __init__(self, n: np.ndarray, view: np.ndarray, views: Views, mirrored: bool):
        self.given, self.view, self.views, self.mirrored = n, view, views, mirrored
        self.n, self.compiled = n, n.dtype == np.float32 and machine_code.is_available()
        if mirrored and self.compiled:
            self.n, self.length = np.empty_like(n), np.empty(len(n), np.float32)
            self.run("forward", STEPS, SETTLED, self.n, self.length)
        elif mirrored:
            for _ in range(STEPS):  # V belongs to the place that is sought
                before, self.middle = self.n, views.middle(self.n)
                other = views.vectors(self.middle)
                self.n, self.length, self.cosine = move_normals(n, view, other, views.least_cosine)
                if np.abs(self.n - before).mean() < SETTLED:
                    break
        self.middle = views.middle(self.n)
        self.coordinates = (views.slopes - self.middle) / views.half[:, None]

    def terms(self, count: int) -> np.ndarray:
        """Return the constant 1 and the terms (K, P) of a polynomial in the offsets."""
        x, y = self.coordinates
        return np.stack([x**i * y**j for i, j in POWERS[:count]]).astype(np.float32)

    def terms_backward(self, by_terms: np.ndarray, first: int = 0) -> np.ndarray:
        """Derivatives (2, P) by the coordinates, from the one (J, P) by terms `first` onwards."""
        (x, y), powers = self.coordinates, POWERS[first : first + len(by_terms)]
        by_x, by_y = np.zeros_like(by_terms[0]), np.zeros_like(by_terms[0])
        for by_term, (i, j) in zip(by_terms, powers, strict=True):
            if i:
                by_x += by_term * (i * x ** (i - 1) * y**j)
            if j:
                by_y += by_term * (j * x**i * y ** (j - 1))
        return np.stack([by_x, by_y])

    def run(self, kernel: str, steps: int, limit: float, *arrays: np.ndarray) -> None:
        """Run a kernel of learn.engines.view_places over all pixels."""
        views = self.views
        limits = np.array([views.least_cosine, limit, *views.half], np.float32)
        given = self.given, self.view, views.frame, views.fit, limits
        reflectance_map.run_in_slices(
            len(self.given),
            PLACED,
            lambda first, last: machine_code.call(
                f"view_places.{kernel}", first, last, steps, *given, *arrays
            ),
        )

    def backward(
        self, by_n: np.ndarray, by_coordinates: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives by the pixels' normals and views (P, 3), from those by places and offsets."""
        if self.compiled:
            return self.backward_compiled(by_n, by_coordinates)
        views, by_view = self.views, np.zeros_like(by_n)
        if by_coordinates is not None:
            by_slopes = by_coordinates / views.half[:, None]
            by_view += views.slopes_backward(by_slopes)
            by_n = by_n - views.middle_backward(self.n, by_slopes)
        if not self.mirrored:
            return by_n, by_view
        by_u = self.by_sum(by_n)
        for _ in range(views.terms):  # n' = moved(n, v, V(n')): the series for V's part in it
            by_middle = views.vectors_backward(self.middle, by_u)
            by_u = self.by_sum(by_n + views.middle_backward(self.n, by_middle))
        n, view = self.given, self.view
        share = 2 * dot(n, by_u) * (self.cosine > np.float32(views.least_cosine))
        return 2 * self.cosine * by_u + share * view, by_view - by_u + share * n

    def backward_compiled(
        self, by_n: np.ndarray, by_coordinates: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray]:
        """As `backward`, by the kernel."""
        pixels, terms = len(by_n), self.views.terms if self.mirrored else -1
        by_offsets = np.zeros((2, pixels), np.float32)
        if by_coordinates is not None:
            by_offsets += by_coordinates
        length = self.length if self.mirrored else by_offsets[0]  # not read
        result = np.empty((pixels, 3), np.float32), np.empty((pixels, 3), np.float32)
        by_place = np.ascontiguousarray(by_n, np.float32)
        self.run("backward", terms, LEAST_DEPTH, self.n, length, by_place, *by_offsets, *result)
        return result

    def by_sum(self, by_n: np.ndarray) -> np.ndarray:
        """Return the derivative by u of n' = u/‖u‖."""
        return (by_n - dot(by_n, self.n) * self.n) / self.length


class Chart:
    """The disk on which maps are drawn: as learn.methods.reflectance_map's, but large enough.

    In perspective, normals turned away from the camera's axis by more than 90° can be seen. `scale`
    draws them within the disk: its squared radius is scale² (1 − n·axis).
    frame  (3, 3) rotation from the camera to the disk, whose third row is the axis
    """

    def __init__(self, n: np.ndarray, frame: np.ndarray):
        self.frame, self.n = frame, rotate(n, frame)
        least = min(float(self.n[:, 2].min()), 0.0)
        self.scale = np.float32(1 / math.sqrt(1 - least))
        self.drawn = self.n
        if self.scale < 1:
            z = self.n[:, 2]
            drawn_z = 1 - self.scale**2 * (1 - z)
            self.stretch = self.scale * np.sqrt((1 + drawn_z) / np.maximum(1 + z, 1e-6))
            self.drawn = np.stack(
                [self.n[:, 0] * self.stretch, self.n[:, 1] * self.stretch, drawn_z], -1
            )

    def normals(self, drawn: np.ndarray) -> np.ndarray:
        """Unit normals (N, 3) float32, camera frame, of nodes as reflectance_map draws them."""
        z = 1 - (1 - drawn[:, 2]) / float(self.scale) ** 2
        ratio = np.maximum(1 + z, 0.0) / np.maximum(1 + drawn[:, 2], 1e-9)
        stretch = np.sqrt(ratio) / float(self.scale)
        inside = np.stack([drawn[:, 0] * stretch, drawn[:, 1] * stretch, z], -1)
        inside /= np.sqrt(dot(inside, inside))
        return rotate(inside, self.frame.T).astype(np.float32)

    def backward(self, by_drawn: np.ndarray) -> np.ndarray:
        """Return the derivative by n (P, 3), from the one by what is drawn."""
        if self.scale < 1:
            by_x, by_y = by_drawn[:, 0] * self.stretch, by_drawn[:, 1] * self.stretch
            x, y, z = self.n[:, 0], self.n[:, 1], self.n[:, 2]
            by_z = -0.5 * (by_x * x + by_y * y) / np.maximum(1 + z, 1e-6)
            by_drawn = np.stack([by_x, by_y, by_z], -1)
        return rotate(by_drawn, self.frame.T)


def rotate(vectors: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """Return vectors (P, 3) rotated, without BLAS, whose threads spin."""
    return np.stack([component_along(vectors, row) for row in rotation], -1)
