"""Polygons cut into triangles by cutting off their ears, whatever their shape.

ear  a corner whose two neighbours see each other: cut off, it leaves a polygon of one corner less.
     Every simple polygon has two (Meisters, "Polygons have ears", 1975). All polygons of a mesh are
     cut at once, in rounds: each round cuts every ear that is better than the ears beside it

A polygon is cut as it lies when seen along its normal (Newell's: half the sum of cross products of
its edges), so one that is not plane is cut by its projection. A polygon that crosses itself has no
right answer: ears are cut while there are any, then the smallest corner; where that covers hardly
less than the fan, the fan stays.

Memory: 500 bytes per corner, and 60 MB. Time: a polygon of 4,000 corners takes 0.1 to 2 seconds, by
its shape.
"""

import numpy as np

from factory.shapes.fans import TINY, fans, squared_lengths
from factory.shapes.ragged import ranges, successors

PAIRS = 500_000  # pairs of an ear and a corner that might lie in it, tested together: 60 MB
MOST_TESTS = 100_000_000  # of such pairs in all, half a minute; real meshes need a thousandth
WORTH = 0.9  # of a polygon that crosses itself: the fan stays unless ears cover so much less
# share of a polygon's area by which its triangles may exceed it before it counts as crossing itself
OVERLAP = 1e-6


class TooLarge(ValueError):
    """Polygons that cannot be cut in bounded time; corners: of the largest."""

    def __init__(self, corners: int) -> None:
        self.corners = corners
        super().__init__(
            f"expected polygons that can be cut in bounded time, found one of {corners} corners"
        )


def cut(vertices: np.ndarray, corners: np.ndarray, lengths: np.ndarray) -> tuple[np.ndarray, int]:
    """Return triangles (F, 3) of polygons, polygon after polygon, and how many cross themselves.

    vertices, corners, lengths  as of factory.shapes.polygons.triangulate
    Raises                      TooLarge
    """
    xy = _flatten(vertices[corners], lengths)
    ears = _Ears(xy, lengths)
    triangles, polygon = ears.cut()
    triangles = triangles[np.argsort(polygon, kind="stable")]
    fan, owner = fans(np.arange(len(xy)), lengths)
    covered = np.bincount(
        owner, np.abs(_cross(xy[fan[:, 1]] - xy[fan[:, 0]], xy[fan[:, 2]] - xy[fan[:, 0]]))
    )
    crossing = ears.crossing()
    kept = (crossing & (ears.covered > WORTH * covered))[owner]
    triangles[kept] = fan[kept]
    return corners[triangles], int(crossing.sum())


def _flatten(points, lengths):
    """Return the polygons' corners (C, 2) seen along their normals, counter-clockwise.

    Each polygon is scaled to size 1.
    """
    polygon = np.repeat(np.arange(len(lengths)), lengths)
    starts = np.cumsum(lengths) - lengths
    points = points - points[starts][polygon]
    ahead = points[successors(lengths)]
    cross = np.cross(points, ahead)
    normal: np.ndarray = np.stack([np.bincount(polygon, cross[:, k]) for k in range(3)], axis=1)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    least = np.eye(3)[np.abs(normal).argmin(axis=1)]  # the axis farthest from the normal
    right = np.cross(normal, least)
    right /= np.maximum(np.linalg.norm(right, axis=1, keepdims=True), 1e-300)
    up = np.cross(normal, right)
    flat = np.stack([np.einsum("ci,ci->c", points, axis[polygon]) for axis in (right, up)], axis=1)
    size = np.maximum.reduceat(np.abs(flat).max(axis=1), starts)
    return flat / np.where(size > 0, size, 1.0)[polygon, None]


class _Ears:
    """Polygons in the plane that lose ears round by round.

    xy             (C, 2), counter-clockwise
    before, after  (C,): the corners beside each one
    left           (P,): corners that a polygon still has
    turn           (C,): doubled area of the triangle at each corner, positive where the polygon is
                   convex
    key            (C,): squared length of the cut that removes the corner; short cuts come first
    """

    def __init__(self, xy: np.ndarray, lengths: np.ndarray) -> None:
        self.xy, self.lengths, self.left = xy, lengths, lengths.copy()
        self.starts = np.cumsum(lengths) - lengths
        self.judged = lengths.copy()  # corners that a polygon had when all of them were judged last
        self.polygon = np.repeat(np.arange(len(lengths)), lengths)
        self.after = successors(lengths)
        self.before = np.empty_like(self.after)
        self.before[self.after] = np.arange(len(xy))
        self.alive, self.ear = np.ones(len(xy), bool), np.zeros(len(xy), bool)
        self.turn, self.key = np.zeros(len(xy)), np.zeros(len(xy))
        self.covered = np.zeros(len(lengths))  # doubled area of the triangles
        self.whole = np.bincount(self.polygon, _cross(xy, xy[self.after]))
        self.tests = self.cuts = 0
        self.blockers: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []

    def cut(self) -> tuple[np.ndarray, np.ndarray]:
        """Return triangles (F, 3) of corners, and the polygon (F,) of each, in cutting order."""
        triangles, owners = [], []
        every = np.arange(len(self.xy))
        self._measure(every)
        self._list_blockers()
        self._judge(every)
        ears = self._with_forced(np.flatnonzero(self.ear), np.arange(len(self.left)))
        while len(ears):
            chosen = self._best(ears)
            beside = np.unique(np.concatenate([self.before[chosen], self.after[chosen]]))
            triangles.append(np.stack([self.before[chosen], chosen, self.after[chosen]], axis=1))
            owners.append(self.polygon[chosen])
            self._take_off(chosen)
            beside = beside[self.alive[beside]]
            self._measure(beside)
            if 2 * self.cuts > self.listed:
                self._list_blockers()
            self._judge(beside)
            ears = np.union1d(ears, beside)
            ears = self._with_forced(ears[self.ear[ears]], np.unique(self.polygon[beside]))
        return np.concatenate(triangles), np.concatenate(owners)

    def crossing(self) -> np.ndarray:
        """Return which polygons (P,) bool their triangles cover more than once somewhere."""
        return self.covered > np.abs(self.whole) + OVERLAP * (np.abs(self.whole) + OVERLAP)

    def _best(self, ears):
        """Return the ears with a shorter cut than the ears beside them; no two are neighbours."""
        best = np.ones(len(ears), bool)
        for beside in (self.before[ears], self.after[ears]):
            shorter = (self.key[beside] < self.key[ears]) | (
                (self.key[beside] == self.key[ears]) & (beside < ears)
            )
            best &= ~(self.ear[beside] & shorter)
        return ears[best]

    def _take_off(self, chosen):
        before, after = self.before[chosen], self.after[chosen]
        self.after[before], self.before[after] = after, before
        self.alive[chosen] = self.ear[chosen] = False
        np.add.at(self.covered, self.polygon[chosen], np.abs(self.turn[chosen]))
        np.subtract.at(self.left, self.polygon[chosen], 1)
        self.cuts += len(chosen)
        done = np.unique(self.polygon[chosen])
        done = done[self.left[done] < 3]
        if len(done):  # what is left of them is an edge
            ends = np.concatenate([before, after])
            ends = ends[np.isin(self.polygon[ends], done)]
            self.alive[ends] = self.ear[ends] = False

    def _measure(self, corners):
        a, b = self.xy[self.before[corners]], self.xy[self.after[corners]]
        v = self.xy[corners]
        self.turn[corners] = _cross(v - a, b - v)
        self.key[corners] = squared_lengths(b - a)

    def _list_blockers(self):
        """List the corners that may lie in a triangle: those where the polygon is not convex.

        They are listed by polygon and x, and by polygon and y.
        """
        self.cuts = 0
        alive = np.flatnonzero(self.alive)
        self.listed = len(alive)
        some = alive[self.turn[alive] <= TINY]
        lists = []
        for axis in (0, 1):
            place = 4.0 * self.polygon[some] + self.xy[some, axis]
            order = np.argsort(place)
            lists.append((some[order], place[order], self.xy[some[order], 1 - axis]))
        self.blockers = lists

    def _judge(self, corners):
        """Determine which corners are ears."""
        a, v, b = self.xy[self.before[corners]], self.xy[corners], self.xy[self.after[corners]]
        back = np.einsum("ci,ci->c", a - v, b - v) >= 0
        line = np.abs(self.turn[corners]) <= TINY
        # a spike, or a doubled corner
        nothing = line & (
            back | (squared_lengths(a - v) <= TINY**2) | (squared_lengths(b - v) <= TINY**2)
        )
        sure = nothing | (self.left[self.polygon[corners]] == 3)
        self.ear[corners] = sure
        convex = corners[(self.turn[corners] > TINY) & ~sure]
        if len(convex):
            self.ear[convex] = ~self._blocked(convex)

    def _blocked(self, corners):
        """Return whether another corner of the polygon keeps each corner (C,) from being an ear."""
        triangle = np.stack([self.before[corners], corners, self.after[corners]], axis=1)
        low, high = self.xy[triangle].min(axis=1), self.xy[triangle].max(axis=1)
        spans = []
        for axis, (_, place, _) in enumerate(self.blockers):
            start = np.searchsorted(place, 4.0 * self.polygon[corners] + low[:, axis] - 1e-7)
            end = np.searchsorted(
                place, 4.0 * self.polygon[corners] + high[:, axis] + 1e-7, side="right"
            )
            spans.append((start, end - start))
        blocked = np.zeros(len(corners), bool)
        by_x = spans[0][1] <= spans[1][1]
        for axis, mine in ((0, by_x), (1, ~by_x)):
            some = np.flatnonzero(mine & (spans[axis][1] > 0))
            if not len(some):
                continue
            start, count = spans[axis][0][some], spans[axis][1][some]
            self.tests += int(count.sum())
            if self.tests > MOST_TESTS:
                raise TooLarge(int(self.left.max()))
            listed, _, across = self.blockers[axis]
            for part in np.split(
                np.arange(len(some)), np.flatnonzero(np.diff(np.cumsum(count) // PAIRS)) + 1
            ):
                which, place = np.repeat(some[part], count[part]), ranges(start[part], count[part])
                near = (across[place] >= low[which, 1 - axis] - TINY) & (
                    across[place] <= high[which, 1 - axis] + TINY
                )
                which, point = which[near], listed[place[near]]
                blocked[which[self._inside(point, which, triangle)]] = True
        return blocked

    def _inside(self, point, which, triangle):
        """Return the pairs (indices) of points that lie in their triangle and block its ear.

        Point (K,) belongs to triangle number which (K,) of (C, 3). A point blocks in the triangle
        and on
        its cut. On the other two sides, and on a corner of the triangle, it touches the polygon,
        and blocks only if the polygon continues from there into the triangle.
        """
        pairs = np.arange(len(point))
        for side in (2, 0, 1):  # the cut first: most points lie beyond it
            pairs = pairs[self._side(point[pairs], triangle[which[pairs]], side) >= -TINY]
        p = point[pairs]
        pairs = pairs[
            self.alive[p]
            & (self.turn[p] <= TINY)
            & (p[:, None] != triangle[which[pairs]]).all(axis=1)
        ]
        p, t = point[pairs], triangle[which[pairs]]
        touching = [np.abs(self._side(p, t, side)) <= TINY for side in range(3)]
        inside = ~(touching[0] | touching[1])
        for beside in (self.before[p], self.after[p]):
            inside |= np.all(
                [(self._side(beside, t, side) > TINY) | ~touching[side] for side in range(3)],
                axis=0,
            )
        return pairs[inside]

    def _side(self, point, triangle, side):
        """Return the doubled area (K,) of each point with a side of its triangle, positive inside.

        Side 2 is the cut.
        """
        start = self.xy[triangle[:, side]]
        return _cross(self.xy[triangle[:, side - 2]] - start, self.xy[point] - start)

    def _with_forced(self, ears, polygons):
        """Return the ears, and some corner of each polygon without one.

        Such a polygon crosses itself, or rounding hides its ears. All its corners are judged again
        when it has lost half of them since the last time.
        """
        stuck = np.setdiff1d(polygons[self.left[polygons] > 2], self.polygon[ears])
        if not len(stuck):
            return ears
        again = stuck[2 * self.left[stuck] <= self.judged[stuck]]
        if len(again):
            self.judged[again] = self.left[again]
            corners = self._corners(again)
            self._judge(corners)
            result = corners[self.ear[corners]]
            ears, stuck = np.union1d(ears, result), np.setdiff1d(stuck, self.polygon[result])
        corners = self._corners(stuck)
        kind = np.where(
            np.abs(self.turn[corners]) <= TINY, 0, np.where(self.turn[corners] > 0, 1, 2)
        )
        corners = corners[np.lexsort((np.abs(self.turn[corners]), kind, self.polygon[corners]))]
        rank = np.arange(len(corners)) - np.repeat(
            np.cumsum(self.left[stuck]) - self.left[stuck], self.left[stuck]
        )
        forced = corners[rank <= self.left[self.polygon[corners]] // 500]
        self.ear[forced] = True
        return np.union1d(ears, forced)

    def _corners(self, polygons):
        """Return the remaining corners of some polygons, polygon after polygon."""
        corners = ranges(self.starts[polygons], self.lengths[polygons])
        return corners[self.alive[corners]]


def _cross(a, b):
    """Return the cross products (N,) of vectors (N, 2)."""
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
