"""The data card of an export: README.md, whose front matter Hugging Face's `datasets` reads."""

import re
from collections.abc import Iterable, Iterator

from manifests.exporting import card_errors
from manifests.exporting.samples import Samples, licences
from manifests.provenance import own_version

SIZES = ((1_000, "n<1K"), (10_000, "1K<n<10K"), (100_000, "10K<n<100K"), (1_000_000, "100K<n<1M"))
CONTENTS = {
    "webdataset": (
        "`NNNNNN.tar`, in each up to {each} samples. A sample is `ID.json` (its record), `ID.png`"
        " (display values) and `ID.npz` (`radiance`, `normals`, `depth`, `segments`, `labels`)."
        ' `webdataset.WebDataset(files).decode("rgb8")` reads them.'
    ),
    "parquet": (
        "`NNNNNN.parquet`, in each up to {each} rows. A row is a sample; arrays are the bytes of"
        " .npy files, `picture` is a PNG."
    ),
    "huggingface": (
        "`data/SPLIT-*.parquet`, in each up to {each} rows, which"
        ' `datasets.load_dataset("parquet", ...)` and `load_dataset(FOLDER)` read. `picture`'
        " arrives decoded, arrays are the bytes of .npy files."
    ),
    "hdf5": (
        "`NNNNNN/N.hdf5`, one file for each sample with the keys of BlenderProc's writer, in each"
        " folder up to {each} files."
    ),
}
LIMITS = (
    "Materials have no textures: each segment has one reflectance.",
    "The light is a distant environment map; there is no floor and no background.",
    "`radiance` is in half precision, at most 65504; the PNG is clipped at white and in 8 bits.",
    "Labels and the Blender mixtures are fitted to measured reflectance; `materials.json` has the"
    " errors of each fit.",
    "`mixed` samples have a shape for training and a material for testing, or the reverse: they"
    " are for neither.",
)


def data_card(samples: Samples, form: str, each: int, author: str = "") -> str:
    """Return the card's text: what, how many, rendered by what, licences, known limits."""
    lines = [*_front_matter(samples, form), *_description(samples, form, each, author)]
    return "\n".join(lines) + "\n"


def plain(text: str) -> str:
    """Return text as one line without characters that Markdown, HTML or YAML would interpret."""
    text = "".join(c if c.isprintable() else " " for c in text)
    return re.sub(r"[<>|`*_\[\]{}\"'\\#&]", " ", text).strip()[:500] or "not stated"


def _front_matter(samples: Samples, form: str) -> Iterator[str]:
    count = len(samples.lines)
    size = next((name for bound, name in SIZES if count < bound), "n>1M")
    yield "---"
    yield "license: other"
    yield "license_name: see-below"
    yield "tags: [synthetic, rendering, materials, normals, depth]"
    yield f"size_categories: [{size}]"
    if form == "huggingface":
        yield "configs:"
        yield "- config_name: default"
        yield "  data_files:"
        present = samples.counts.splits
        for split in (name for name in ("train", "test", "mixed") if name in present):
            yield f"  - split: {split}"
            yield f"    path: data/{split}-*.parquet"
    yield "---"


def _description(samples: Samples, form: str, each: int, author: str) -> Iterator[str]:
    dataset, counts = samples.dataset, samples.counts
    jobs = ", ".join(plain(order.job.name) for order in dataset.orders) or "not recorded"
    yield "# " + (
        "Pictures with normals, depth, segments and material labels"
        if samples.pictures
        else "Views: normals, depth and segments without pictures"
    )
    yield ""
    yield f"Jobs: {jobs}."
    yield "`dataset.json` has the jobs with all settings, `materials.json` the labels, `lights/`"
    yield "the light maps."
    yield ""
    yield CONTENTS[form].format(each=each)
    yield ""
    yield "## How many"
    yield ""
    yield "| what | number |"
    yield "|---|---|"
    yield f"| samples | {len(samples.lines)} |"
    for split in sorted(counts.splits):
        yield f"| of the split {split} | {counts.splits[split]} |"
    yield f"| shapes | {len(counts.shapes)} |"
    if samples.pictures:
        yield f"| materials | {len(counts.materials)} |"
        yield f"| lights | {len(counts.lights)} |"
        for tier in sorted(counts.tiers):
            yield f"| of light transport {tier} | {counts.tiers[tier]} |"
    for size, number in sorted(counts.sizes.items()):
        yield f"| of {size[0]} × {size[1]} pixels | {number} |"
    yield ""
    yield from card_errors.section(counts.errors)
    yield "## Rendered by"
    yield ""
    programs = {"brdfactory": own_version(), **dataset.versions}
    if author:
        yield f"{plain(author)}, with:"
        yield ""
    yield from (f"- {plain(name)} {plain(each)}" for name, each in sorted(programs.items()))
    yield ""
    yield "## Licences"
    yield ""
    yield "What the makers of the assets state; the pictures depend on all of them."
    yield ""
    yield "| assets | licence | number |"
    yield "|---|---|---|"
    for kind, numbers in licences(dataset).items():
        yield from _licence_rows(kind, numbers.items())
    yield ""
    yield "## Known limits"
    yield ""
    limits = [*LIMITS, *card_errors.limits(counts.errors)] if samples.pictures else LIMITS[1:2]
    yield from (f"- {limit}" for limit in limits)


def _licence_rows(kind: str, counts: Iterable[tuple[str, int]]) -> Iterator[str]:
    yield from (f"| {kind} | {plain(licence)} | {count} |" for licence, count in counts)
