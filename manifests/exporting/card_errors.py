"""What a data card says of the error of pictures whose job limits it, and of their bias."""

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from statistics import fmean

from manifests.schema import Accuracy, Estimator, Record

# {estimator: (what it is, its bias)}; factory.render.estimators has a card for each
ESTIMATORS: dict[Estimator, tuple[str, str]] = {
    "path-tracing": (
        "path tracing with the samples that the picture needs",
        "none in radiance; display values of a noisy picture are a little too dark on average",
    ),
    "denoised": (
        "path tracing and Open Image Denoise",
        "detail that noise hides is smoothed, in sharp reflections most of all",
    ),
    "ratio": (
        "direct light computed without noise, times the denoised ratio of the picture to one"
        " without shadows and interreflection",
        "the denoiser's, where it treats the two pictures differently, and interreflection in"
        " strong highlights, which is cut off",
    ),
    "closed-form": (
        "direct light computed without noise, alone",
        "in the tiers `shadow` and `full`, what the object blocks or reflects onto itself; in all"
        " tiers, parts so thin that the points that are computed in a pixel miss them",
    ),
}
ERROR = """\
Jobs can limit the error of their pictures. An error is the mean squared difference of sRGB values
from 0 to 255 over the object, of noise and bias together, under the exposure that brings the 99th
percentile of luminance to 1. It is estimated from two halves of the picture with independent seeds;
`accuracy` in the records has the estimates."""
# docs/error-limit.md has the figures: 285 of 300 pictures, and 380 of 400 of other meshes
BIAS = """\
By its estimate, the squared bias of each picture that is not path-traced is at most a third of the
limit. Some of these are blended with the noisy picture, which lowers their bias. No estimate
includes light that hardly any sample finds, such as highlights of small lamps.

Compared with references of many samples, 95 % of 700 random pictures of this program kept both the
limit on the error and that on its bias."""
SAMPLES = "the records give the samples of each pixel."


def section(records: Sequence[Record]) -> Iterator[str]:
    """Yield the lines on the errors of records that have a limit on them; none if none has."""
    limited = _accuracies(records)
    if not limited:
        return
    yield "## Error of the pictures"
    yield ""
    yield ERROR
    yield ""
    yield "| limit on the error | pictures | estimated error: mean | largest | above the limit |"
    yield "|---|---|---|---|---|"
    for limit in sorted({each.requested for each in limited}):
        errors = [each.estimated for each in limited if each.requested == limit]
        above = sum(error > limit for error in errors)
        yield f"| {limit:g} | {len(errors)} | {fmean(errors):.3g} | {max(errors):.3g} | {above} |"
    if len(limited) < len(records):
        yield f"| none | {len(records) - len(limited)} | – | – | – |"
    yield ""
    yield "Each picture with a limit was made by the estimator that seemed to keep it cheapest:"
    yield ""
    yield "| estimator | pictures | what it is | bias |"
    yield "|---|---|---|---|"
    counts = Counter(each.estimator for each in limited)
    for name, (what, bias) in ESTIMATORS.items():
        if counts[name]:
            yield f"| {name} | {counts[name]} | {what} | {bias} |"
    yield ""
    if counts.total() > counts["path-tracing"]:
        yield BIAS
        yield ""


def limits(records: Sequence[Record]) -> Iterator[str]:
    """Yield what the card's known limits say of noise and bias."""
    limited = len(_accuracies(records))
    if not limited:
        yield f"Noise of path tracing is in the pictures: {SAMPLES}"
        return
    yield (
        "Pictures with a limit on their error have noise and, by some estimators, bias: see Error"
        " of the pictures."
    )
    if left := len(records) - limited:
        yield (
            f"Noise of path tracing is in the {left} pictures without a limit on their error:"
            f" {SAMPLES}"
        )


def _accuracies(records: Iterable[Record]) -> list[Accuracy]:
    """Return the accuracies of the records that have one."""
    return [record.accuracy for record in records if record.accuracy is not None]
