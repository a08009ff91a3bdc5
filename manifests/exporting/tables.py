"""Parts as Parquet tables: plain, or with the features that Hugging Face's `datasets` reads.

A row is a sample. Nested keys of its line become columns such as `camera.size`, null where the line
lacks them, as `accuracy.requested` of a job without a limit on the error. Arrays are the bytes of
.npy files (`numpy.load(io.BytesIO(value))`), and `picture` is a PNG. In the Hugging Face layout
`picture` is that library's Image, so that it arrives decoded.
"""

import itertools
from collections.abc import Iterator
from typing import Any, BinaryIO

import msgspec

from manifests.errors import InputError
from manifests.exporting.samples import Sample, Samples, npy_bytes, png_bytes

ROWS = 64  # of a row group: what is in memory at once, 100 MB at 256 × 256
RECORD_TYPES = (  # column, Arrow's type; the order of a table's columns
    ("id", "string"),
    ("shape", "string"),
    ("shape_hash", "string"),
    ("category", "string"),
    ("viewpoint", "int32"),
    ("azimuth_deg", "double"),
    ("camera.size", "list<int32>"),
    ("camera.fov_deg", "double"),
    ("camera.elevation_deg", "double"),
    ("camera.half_extent", "double"),
    ("camera.pixel", "string"),
    ("camera.roll_deg", "double"),
    ("split", "string"),
    ("geometry_hash", "string"),
    ("coverage", "double"),
)
PICTURE_TYPES = (
    ("materials", "list<string>"),
    ("light", "string"),
    ("light_hash", "string"),
    ("rotation_texels", "int32"),
    ("tier", "string"),
    ("light_resolution", "string"),
    ("samples", "int64"),
    ("seed", "int64"),
    ("image_hash", "string"),
    ("mean", "double"),
    ("max", "double"),
    ("exposure", "double"),
    ("accuracy.requested", "double"),
    ("accuracy.estimator", "string"),
    ("accuracy.predicted", "double"),
    ("accuracy.estimated", "double"),
    ("accuracy.standard_error", "double"),
    ("accuracy.seconds", "double"),
    ("accuracy.traced", "string"),
)
GEOMETRY_ARRAYS = ("normals", "depth", "segments")
PICTURE_ARRAYS = ("radiance", "labels")


def require_package() -> None:
    """Raise InputError where pyarrow is missing."""
    try:
        import pyarrow.parquet  # noqa: F401 (is it there?)
    except ImportError as error:
        remedy = (
            "pip install 'pyarrow<22' (later ones need numpy 2, which Blender's wheel cannot have)"
        )
        raise InputError(
            "export --to parquet or huggingface",
            "the package pyarrow",
            str(error).split(":")[0],
            remedy,
        ) from None


def columns(pictures: bool) -> dict[str, str]:
    """Return {column: type} of the tables; "binary" for arrays and "image" for the picture."""
    names = [*RECORD_TYPES, *(PICTURE_TYPES if pictures else [("segment_count", "int32")])]
    if pictures:
        names.append(("picture", "image"))
    arrays = GEOMETRY_ARRAYS + (PICTURE_ARRAYS if pictures else ())
    return dict([*names, *((name, "binary") for name in arrays)])


def write_parquet(file: BinaryIO, samples: Iterator[Sample], source: Samples) -> None:
    """Write samples to a stream as one Parquet file."""
    _write(file, samples, columns(source.pictures), as_feature=False)


def write_huggingface(file: BinaryIO, samples: Iterator[Sample], source: Samples) -> None:
    """Write samples to a stream as a Parquet file with the features of `datasets`."""
    _write(file, samples, columns(source.pictures), as_feature=True)


def _write(
    file: BinaryIO, samples: Iterator[Sample], types: dict[str, str], as_feature: bool
) -> None:
    import pyarrow
    import pyarrow.parquet

    schema = pyarrow.schema([(name, _arrow(kind, as_feature)) for name, kind in types.items()])
    if as_feature:
        features = {name: feature(kind) for name, kind in types.items()}
        text = msgspec.json.encode({"info": {"features": features}})
        schema = schema.with_metadata({"huggingface": text})
    with pyarrow.parquet.ParquetWriter(file, schema, compression="zstd") as writer:
        while rows := [_row(sample, as_feature) for sample in itertools.islice(samples, ROWS)]:
            writer.write_table(pyarrow.Table.from_pylist(rows, schema=schema))


def _arrow(kind: str, as_feature: bool) -> Any:
    """Return Arrow's type of a column."""
    import pyarrow

    if kind == "image":
        if not as_feature:
            return pyarrow.binary()
        return pyarrow.struct([("bytes", pyarrow.binary()), ("path", pyarrow.string())])
    if kind.startswith("list<"):
        return pyarrow.list_(pyarrow.type_for_alias(kind.removeprefix("list<").removesuffix(">")))
    return pyarrow.type_for_alias(kind)


def feature(kind: str) -> dict[str, Any]:
    """Return a column's feature as `datasets` keeps it in a Parquet file's metadata."""
    if kind == "image":
        return {"_type": "Image"}
    if kind.startswith("list<"):
        inner = kind.removeprefix("list<").removesuffix(">")
        return {"feature": feature(inner), "_type": "List"}
    return {"dtype": {"double": "float64"}.get(kind, kind), "_type": "Value"}


def _row(sample: Sample, as_feature: bool) -> dict[str, Any]:
    """Return a sample's row; a column that it lacks is missing and becomes null."""
    values = sample.metadata()
    row = {key: value for key, value in values.items() if not isinstance(value, dict)}
    for name in ("camera", "accuracy"):
        row |= {f"{name}.{key}": value for key, value in values.get(name, {}).items()}
    row.setdefault("camera.roll_deg", 0.0)
    row |= values.get("statistics", {})
    row["split"] = sample.split
    if "segments" in row:
        row["segment_count"] = row.pop("segments")
    if sample.display is not None:
        png = png_bytes(sample.display)
        row["picture"] = {"bytes": png, "path": f"{sample.line.id}.png"} if as_feature else png
    return row | {name: npy_bytes(array) for name, array in sample.arrays().items()}
