"""Arrays in zip files: whatever their headers say, the answer is an array or one kind of error."""

import io
import random
import struct
import zipfile

import numpy as np
import pytest

from manifests import archives
from manifests.archives import ArrayHeader
from manifests.errors import InputError
from manifests.light_files import encode_light, read_light, read_scale

HEADER = "{'descr': '<f4', 'fortran_order': False, 'shape': (64, 128, 3), }\n"
VERSIONS = ((1, 0), (2, 0), (3, 0))


def stream(text, version=(1, 0)):
    """An .npy stream with this header and no values."""
    data = text.encode("latin-1")
    length = struct.pack("<H" if version == (1, 0) else "<I", len(data))
    return io.BytesIO(b"\x93NUMPY" + bytes(version) + length + data)


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize(
    "text",
    [
        HEADER[:40],  # tokens that never end
        HEADER.replace("(64", "((64"),
        "(" * 500 + ")" * 500,
        "[" * 9000,
        "-" * 9000 + "1",
        "{[]: 1}",
        HEADER.replace("'<f4'", "None"),
        HEADER.replace("'<f4'", "'|O'"),
        HEADER.replace("64", "-64"),
        HEADER.replace("64", "True"),
        "",
    ],
)
def test_a_damaged_array_header_is_a_value_error(text, version):
    with pytest.raises(ValueError):
        ArrayHeader(stream(text, version))


def test_noise_in_an_array_header_is_never_another_error():
    rng = random.Random(1)
    for _ in range(3000):
        letters = list(HEADER)
        for _ in range(rng.choice((1, 1, 2, 5))):
            place = rng.randrange(len(letters))
            letters[place] = rng.choice(
                (
                    "",
                    "",
                    chr(rng.randrange(256)),
                    letters[place] + rng.choice("([{'\"\\L,:#\0\t \n"),
                )
            )
        try:
            assert len(ArrayHeader(stream("".join(letters), rng.choice(VERSIONS))).shape) <= 64
        except archives.DAMAGE:
            continue


def light_with(tmp_path, member, content):
    """A stored light's file, one of its members replaced."""
    L = np.ones((64, 128, 3), np.float32)
    with zipfile.ZipFile(io.BytesIO(encode_light(L, 1.0))) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    path = tmp_path / "light.npz"
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in (members | {member: content}).items():
            archive.writestr(name, data)
    return path


@pytest.mark.parametrize(("member", "read"), [("L.npy", read_light), ("scale.npy", read_scale)])
@pytest.mark.parametrize("text", [HEADER[:40], "{[]: 1}", "[" * 9000])
def test_a_stored_light_with_a_damaged_array_header_is_told_in_one_line(
    tmp_path, member, read, text
):
    path = light_with(tmp_path, member, stream(text).getvalue())
    with pytest.raises(InputError, match="a damaged array header"):
        read(path)


@pytest.mark.parametrize("text", [HEADER[:40], "{[]: 1}", "[" * 9000])
def test_light_maps_for_training_with_a_damaged_array_header_are_told_in_one_line(tmp_path, text):
    from learn.data.lights import read_maps

    path = light_with(tmp_path, "L.npy", stream(text).getvalue())
    with pytest.raises(InputError, match="a damaged array header"):
        read_maps(path)
