"""Tables of `photographed-edits`: rules for an edit's brightness, and the line of exposures.

Edits were made under one exposure, and their L2 is known if they were brighter by each of SCALES.
Between these L2 is interpolated, and beyond them it is that of the last. So every rule is applied
to the same decompositions. E: number of edits.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from learn.editing import exposure, mirror_correction
from learn.experiments import runner
from learn.metrics import bootstrap

if TYPE_CHECKING:
    from learn.experiments.runner import Report

SCALES = tuple(k / 4 for k in range(-16, 17))  # in stops
TERMS = ("constant", "object", "again", "background", "narrow")
WITH_BACKGROUND = ("constant", "again", "background", "narrow")  # of the line in use
CUT_OUT = ("constant", "again", "narrow")  # of that without a background
SHARES = (0.0, 0.2, 0.4, 0.6, 0.8, 1.01)
METALS = ("metal", "metallic paint")
# until 2026-11-28: share of the ratio that corrected exposures, and stops by which at most
TRUST_BEFORE, MOST_BEFORE = 0.75, 3.0
BEFORE, IN_USE = "corrected by three quarters of the ratio, as before", "in use"


@dataclass(frozen=True)
class Edits:
    """The edits of a report whose photographs have all cues; arrays over E.

    rows       what a photograph's row and an edit's say
    cues       (E, 5) 1, object, again, background as a line sees it, the target's narrow share
    used       exposure of the photograph, stops
    darkened   stops by which the target was rendered darker
    true       exposure of the photograph that is right, stops
    stops, l2  of the edits beside their truth: (E,), (E, SCALES)
    unchanged  L2 of the photograph as it was
    """

    rows: Sequence[Mapping[str, Any]]
    cues: np.ndarray
    used: np.ndarray
    darkened: np.ndarray
    true: np.ndarray
    stops: np.ndarray
    l2: np.ndarray
    unchanged: np.ndarray

    @property
    def right(self) -> np.ndarray:
        """Stops (E,) by which an edit would have to be exposed to be as bright as its truth."""
        return self.used + self.darkened + self.stops

    def names(self, key: str) -> list[str]:
        """Return "shape", "light", "group", "source", "target" or "family" of each edit."""
        return [str(row[key]) for row in self.rows]

    def brightness(self, stops: np.ndarray) -> np.ndarray:
        """Return stops (E,) above the truth of edits that are exposed by so many stops (E,)."""
        return self.right - stops

    def error(self, stops: np.ndarray) -> np.ndarray:
        """Return L2 (E,) of edits that are exposed by so many stops (E,)."""
        brighter = self.used + self.darkened - stops
        first, step = SCALES[0], SCALES[1] - SCALES[0]
        at = ((brighter - first) / step).clip(0, len(SCALES) - 1.001)
        k, number = at.astype(int), np.arange(len(at))
        return self.l2[number, k] * (k + 1 - at) + self.l2[number, k + 1] * (at - k)


def edits_of(report: Report) -> Edits:
    """Return the Edits of a report."""
    rows, cues = [], []
    for photograph in report["rows"]:
        for edit in photograph["edits"]:
            known = photograph["cues"]
            if None not in known.values():
                rows.append(photograph | edit)
                behind = float(np.clip(known["background"], *exposure.BACKGROUNDS))
                cues.append([1.0, known["object"], known["again"], behind, edit["narrow"]])
    return Edits(
        rows,
        np.array(cues).reshape(-1, len(TERMS)),
        used=np.array([row["exposure"]["used"] for row in rows]),
        true=np.array([row["exposure"]["true"] for row in rows]),
        **{
            key: np.array([row[key] for row in rows])
            for key in ("darkened", "stops", "l2", "unchanged")
        },
    )


def fitted(edits: Edits, terms: Sequence[str], weights: np.ndarray | None = None) -> np.ndarray:
    """Return slopes (5,) of TERMS, least squares of brightness, 0 for those that are left out.

    That of the target's narrow share is fitted under the true exposure: which materials a scene
    was rendered in ties targets to sources, and these to what can be seen of the exposure.

    weights  (E,) of edits
    """
    weights = np.ones(len(edits.rows)) if weights is None else weights
    slopes = np.zeros(len(TERMS))
    rest = edits.right
    if "narrow" in terms:
        straight = edits.cues[:, [0, 4]]
        slopes[4] = least_squares(straight, edits.right - edits.true, weights)[1]
        rest = rest - slopes[4] * edits.cues[:, 4]
    columns = [TERMS.index(term) for term in terms if term != "narrow"]
    slopes[columns] = least_squares(edits.cues[:, columns], rest, weights)
    return slopes


def least_squares(columns: np.ndarray, values: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return slopes (T,) of columns (E, T) by which they are nearest to values (E,), weighted."""
    scale = np.sqrt(weights)
    return np.linalg.lstsq(columns * scale[:, None], values * scale, rcond=None)[0]


def by_others(edits: Edits, terms: Sequence[str]) -> np.ndarray:
    """Return the stops (E,) of a line fitted to edits of other shapes under other lights."""
    shapes, lights = (np.array(edits.names(key)) for key in ("shape", "light"))
    result = np.zeros(len(edits.rows))
    for shape in set(shapes):
        for light in set(lights[shapes == shape]):
            own = (shapes == shape) & (lights == light)
            others = ((shapes != shape) & (lights != light)).astype(float)
            result[own] = edits.cues[own] @ fitted(edits, terms, others)
    return result


def in_use(edits: Edits, cut_out: bool = False) -> np.ndarray:
    """Return the stops (E,) by which the program exposes edits now, the target's among them.

    cut_out  whether the photographs have no background
    """
    cues = [exposure.Cues(*map(float, row[1:4])) for row in edits.cues]
    if cut_out:
        cues = [replace(each, background=None) for each in cues]
    photograph = np.array([np.log2(exposure.exposure_from_cues(each)) for each in cues])
    return photograph + mirror_correction.STOPS * edits.cues[:, 4]


def rules_of(edits: Edits) -> dict[str, np.ndarray]:
    """Return {rule that exposes edits: stops (E,)}."""
    first = exposure.FIRST.constant + exposure.FIRST.object * edits.cues[:, 1]
    share = edits.cues[:, 4]
    return {
        "the first guess": first,
        BEFORE: first + (TRUST_BEFORE * edits.cues[:, 2]).clip(-MOST_BEFORE, MOST_BEFORE),
        IN_USE: in_use(edits),
        "in use, for a cut-out": in_use(edits, cut_out=True),
        "in use, mirror-like targets not darker": in_use(edits) - mirror_correction.STOPS * share,
        "one exposure for all, fitted": by_others(edits, ("constant", "narrow")),
        "fitted without the background": by_others(edits, CUT_OUT),
        "fitted": by_others(edits, WITH_BACKGROUND),
        "fitted, with the object's brightness": by_others(edits, TERMS),
        "the true exposure": edits.true,
        "the true exposure, mirror-like targets darker": edits.true
        + mirror_correction.STOPS * share,
    }


def page(report: Report) -> str:
    """Return the report's tables in Markdown."""
    edits = edits_of(report)
    if not edits.rows:
        return "# Edits of photographs\n\nNo photograph has all cues.\n"
    weights = weights_of(edits)
    refused = sum("refused" in row for row in report["rows"])
    unknown = sum(None in row.get("cues", {}).values() for row in report["rows"])
    metals = np.isin(edits.names("family"), METALS)
    result = ["# Edits of photographs\n", *(f"**{sentence}**\n" for sentence in report["seen"])]
    result.append(
        f"Weights {report['weights']}; {len(edits.rows)} edits of"
        f" {len({row['photograph'] for row in edits.rows})} photographs,"
        f" {len(set(edits.names('shape')))} shapes, {len(set(edits.names('light')))} lights;"
        f" {refused} further photographs were refused, and {unknown} left out because a cue is"
        " missing.\n\n"
        "*Brightness*: mean luminance of the edit over the object, in stops above the truth's."
        " *Off by*: its root mean square. L2 is that of display values, in the photograph's own"
        " exposure. Fitted lines are fitted to edits of other shapes under other lights. Brackets"
        " are 95 % intervals that draw shapes, target materials and lights.\n"
    )
    shown = rules_of(edits)
    result.append("## Rules that expose an edit\n")
    head = ["rule", "brightness, stops", "off by", "L2", "L2 of metals", "of other materials"]
    lines: list[list[object]] = [
        [
            "the photograph, not edited",
            "",
            "",
            runner.mean_interval(edits.unchanged, weights, 0),
            _mean(edits.unchanged[metals]),
            _mean(edits.unchanged[~metals]),
        ]
    ]
    for name, stops in shown.items():
        off, l2 = edits.brightness(stops), edits.error(stops)
        lines.append(
            [
                name,
                runner.mean_interval(off, weights, 2),
                f"{np.sqrt((off**2).mean()):.2f}",
                runner.mean_interval(l2, weights, 0),
                _mean(l2[metals]),
                _mean(l2[~metals]),
            ]
        )
    result.append(runner.table(head, lines))
    result.append(f"Metals: {', '.join(METALS)}; {metals.sum()} edits.\n")
    before, now = (edits.error(shown[name]) for name in (BEFORE, IN_USE))
    ratio = runner.ratio_interval(before, now, weights, 2)
    result.append(
        f"In use, L2 is {ratio} times what it was before; {(now < before).sum()} of"
        f" {len(now)} edits are better.\n"
    )
    result += ["## In groups\n", _groups(edits, before, now)]
    result += ["## The line\n", _line(edits, weights)]
    result.append(
        "## Mirror-like targets\n\nBrightness under the true exposure, of targets that are not"
        " darkened, by the share of their albedo in narrow lobes.\n"
    )
    result.append(_shares(edits, weights))
    result.append(
        "## Colour\n\nOf the mean over the object, beyond the truth's, in stops. Green: above the"
        " mean of red and blue. As it was read: with the green of the light that was read.\n"
    )
    result.append(_colours(edits, weights))
    if all("l2_coloured" in row for row in edits.rows):  # reports of before 2026-11-29 lack it
        result.append(
            "## What brightness and colour cost\n\nL2 of edits whose brightness, or the colour of"
            " whose mean too, were the truth's.\n"
        )
        result.append(_known_means(edits, weights))
    return "\n".join(result)


def _groups(edits: Edits, before: np.ndarray, now: np.ndarray) -> str:
    lines = []
    off = edits.brightness(in_use(edits))
    kinds: dict[str, Callable[[Mapping[str, Any]], str]] = {
        "shapes": lambda row: row["group"],
        "photographs of": lambda row: row["source"],
        "edits into": lambda row: row["family"],
        "lights": lambda row: _kind_of_light(row["light"]),
    }
    for kind, key in kinds.items():
        names = np.array([key(row) for row in edits.rows])
        for name in sorted(set(names)):
            of = names == name
            lines.append(
                [
                    kind,
                    name,
                    of.sum(),
                    f"{off[of].mean():+.2f}",
                    f"{np.sqrt((off[of] ** 2).mean()):.2f}",
                ]
                + [f"{l2[of].mean():.0f}" for l2 in (before, now)]
            )
    head = ["", "", "edits", "brightness, stops", "off by", "L2 before", "L2 in use"]
    return runner.table(head, lines)


def _kind_of_light(name: str) -> str:
    """Return what a light is by its name: a map's, or a place's of room_photographs."""
    kinds = {"room": "in the room itself", "sky": "under the sky itself"}
    place, dash, _ = name.partition("-")
    return kinds.get(place, "rendered rooms") if dash else "measured"


def _line(edits: Edits, weights: np.ndarray) -> str:
    used = {
        "with background": (exposure.WITH_BACKGROUND, WITH_BACKGROUND),
        "cut out": (exposure.CUT_OUT, CUT_OUT),
    }
    lines = []
    for name, (line, terms) in used.items():
        slopes = fitted(edits, terms)
        drawn = np.array([fitted(edits, terms, each) for each in weights[:500]])
        low, high = np.percentile(drawn, bootstrap.LEVELS, axis=0)
        now = [line.constant, line.object, line.again, line.background, mirror_correction.STOPS]
        for k, term in enumerate(TERMS):
            shown = runner.interval([slopes[k], low[k], high[k]], 2) if term in terms else ""
            lines.append([name, term, f"{now[k]:+.2f}", shown])
    return runner.table(["", "slope of", "in use", "fitted"], lines)


def _shares(edits: Edits, weights: np.ndarray) -> str:
    too_bright, share = edits.right - edits.true, edits.cues[:, 4]
    lines = []
    for low, high in itertools.pairwise(SHARES):
        of = (share >= low) & (share < high)
        drawn = weights[:, of]
        if of.any():
            mean = bootstrap.interval(too_bright[of], drawn[drawn.sum(1) > 0])
            lines.append([f"{low:.1f} to {min(high, 1):.1f}", of.sum(), runner.interval(mean, 2)])
    return runner.table(["share", "edits", "brightness, stops"], lines)


def _colours(edits: Edits, weights: np.ndarray) -> str:
    green, red_blue = (np.array([row[key] for row in edits.rows]) for key in ("green", "red_blue"))
    as_read = green + np.array([row["light_green"] for row in edits.rows])
    shown = {"green, in use": green, "green, as it was read": as_read, "red over blue": red_blue}
    lines = [
        [
            name,
            runner.mean_interval(off, weights, 2),
            f"{np.sqrt((off**2).mean()):.2f}",
        ]
        for name, off in shown.items()
    ]
    return runner.table(["", "mean", "off by"], lines)


def _known_means(edits: Edits, weights: np.ndarray) -> str:
    now = edits.error(in_use(edits))
    coloured = np.array([row["l2_coloured"] for row in edits.rows])
    shown = {
        "in use": now,
        "in use, in the truth's mean colour": replace(edits, l2=coloured).error(in_use(edits)),
        "at each edit's best brightness": edits.l2.min(1),
        "the same, in the truth's mean colour": coloured.min(1),
    }
    lines = [
        [
            name,
            runner.interval(bootstrap.interval(l2, weights), 0),
            runner.interval(bootstrap.relative(now, l2, weights), 2),
        ]
        for name, l2 in shown.items()
    ]
    return runner.table(["edits", "L2", "as a part of those in use"], lines)


def _mean(values: np.ndarray) -> str:
    return f"{values.mean():.0f}" if values.size else "–"


def weights_of(edits: Edits) -> np.ndarray:
    """Return weights (D, E) of draws of shapes, target materials and lights."""
    return bootstrap.draws(bootstrap.groups_of(*map(edits.names, ("shape", "target", "light"))))
