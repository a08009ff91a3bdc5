"""What a data card says of the error of pictures whose job limits it, and of their bias."""

from array import array
from collections import Counter
from collections.abc import Iterator
from statistics import fmean

from manifests.schema import Estimator, Record
from manifests.wording import number_of

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


class Errors:
    """The estimated errors of the pictures of a data set, gathered one after the other.

    pictures    number of all pictures
    estimated   {limit on the error: estimated errors of the pictures that have it}
    estimators  {estimator: number of pictures with a limit that it made}
    """

    def __init__(self) -> None:
        self.pictures = 0
        self.estimated: dict[float, array[float]] = {}
        self.estimators: Counter[Estimator] = Counter()

    def add(self, record: Record) -> None:
        """Count a picture."""
        self.pictures += 1
        if (accuracy := record.accuracy) is not None:
            self.estimated.setdefault(accuracy.requested, array("d")).append(accuracy.estimated)
            self.estimators[accuracy.estimator] += 1

    @property
    def limited(self) -> int:
        """Number of pictures with a limit on their error."""
        return self.estimators.total()


def section(errors: Errors) -> Iterator[str]:
    """Yield the lines on the errors of pictures that have a limit on them; none if none has."""
    if not errors.limited:
        return
    yield "## Error of the pictures"
    yield ""
    yield ERROR
    yield ""
    yield "| limit on the error | pictures | estimated error: mean | largest | above the limit |"
    yield "|---|---|---|---|---|"
    for limit, each in sorted(errors.estimated.items()):
        above = sum(error > limit for error in each)
        yield f"| {limit:g} | {len(each)} | {fmean(each):.3g} | {max(each):.3g} | {above} |"
    if errors.limited < errors.pictures:
        yield f"| none | {errors.pictures - errors.limited} | – | – | – |"
    yield ""
    yield "Each picture with a limit was made by the estimator that seemed to keep it cheapest:"
    yield ""
    yield "| estimator | pictures | what it is | bias |"
    yield "|---|---|---|---|"
    for name, (what, bias) in ESTIMATORS.items():
        if errors.estimators[name]:
            yield f"| {name} | {errors.estimators[name]} | {what} | {bias} |"
    yield ""
    if errors.limited > errors.estimators["path-tracing"]:
        yield BIAS
        yield ""


def limits(errors: Errors) -> Iterator[str]:
    """Yield what the card's known limits say of noise and bias."""
    if not errors.limited:
        yield f"Noise of path tracing is in the pictures: {SAMPLES}"
        return
    yield (
        "Pictures with a limit on their error have noise and, by some estimators, bias: see Error"
        " of the pictures."
    )
    if left := errors.pictures - errors.limited:
        whose = "its" if left == 1 else "their"
        yield (
            f"Noise of path tracing is in the {number_of(left, 'picture')} without a limit on"
            f" {whose} error: {SAMPLES}"
        )
