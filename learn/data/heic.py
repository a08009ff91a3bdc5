"""Opens HEIC, in which iPhones and other phones store photographs, with the package pillow-heif.

The package is optional (extra `heic`) and is imported only when such a file is opened. Its image is
upright and has eight bits per channel; deeper ones are rounded.
"""

from pathlib import Path

from PIL import Image

from learn.data.file_kinds import HEIC_REMEDY
from manifests.errors import InputError

# of a file, all of which is read into memory; one of 48 megapixels has about 10 MB
MOST_BYTES = 256 << 20
INSTALL = "pip install '.[heic]' in a checkout, to read it"


def open_image(path: str | Path) -> Image.Image:
    """Return the Pillow image of a HEIC file, of which only the header was decoded.

    Raises  InputError if the package is not installed, or for a file of more than MOST_BYTES;
            SyntaxError for a damaged one
    """
    try:
        from pillow_heif import HeifImageFile, options
    except ImportError:
        rule = "the package pillow-heif, which reads HEIC"
        raise InputError(path, rule, "none", f"{INSTALL}; or {HEIC_REMEDY}") from None
    if (size := Path(path).stat().st_size) > MOST_BYTES:
        rule = f"a HEIC of at most {MOST_BYTES >> 20} MB"
        raise InputError(path, rule, f"{size >> 20} MB", HEIC_REMEDY)
    # a file may hold these beside its picture, but they are not used
    options.THUMBNAILS = options.DEPTH_IMAGES = options.AUX_IMAGES = False
    return HeifImageFile(path)
