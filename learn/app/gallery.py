"""Pictures of all materials, and their search by everyday words.

The pictures come with the program as one picture of tiles, materials.jpg, in the order of
`families`: each is a sphere in the material, in preview lighting. Drawing them takes 20 seconds:

    python -m learn.app.gallery
"""

import functools
import html
import re
from pathlib import Path

import numpy as np
from PIL import Image

from learn.editing import targets
from learn.editing.material_list import FAMILY_WORDS
from manifests import files
from manifests.described_materials import DESCRIBED
from manifests.material_words import ALIKE
from manifests.materials import load_catalogue
from manifests.wording import number_of

PICTURES = Path(__file__).with_name("materials.jpg")
TILE, COLUMNS = 80, 16  # pixels, tiles in a row
QUALITY = 88


@functools.cache
def families() -> dict[str, str]:
    """Return {name: family} of all materials by name: the described, then the catalogue's."""
    described = {name: material.family for name, material in DESCRIBED.items()}
    return described | {name: material.family for name, material in load_catalogue().items()}


@functools.cache
def tiles() -> dict[str, np.ndarray]:
    """Return {name: picture (TILE, TILE, 3) uint8} of all materials."""
    with Image.open(PICTURES) as opened:
        picture = np.asarray(opened.convert("RGB"))
    result = {}
    for number, name in enumerate(families()):
        row, column = divmod(number, COLUMNS)
        result[name] = picture[row * TILE :, column * TILE :][:TILE, :TILE]
    return result


@functools.cache
def words() -> dict[str, str]:
    """Return {name: the words by which a material is looked for, in lower case}."""
    result = {}
    for name, family in families().items():
        alike = " ".join(word for word, names in ALIKE.items() if name in names)
        family = f"{family} {FAMILY_WORDS.get(family, '')}"
        result[name] = re.sub(r"[-_]", " ", f"{name} {family} {alike}").lower()
    return result


def page_tiles(names: list[str], address: str, text: str = "") -> str:
    """Return HTML with a button for each of the named materials: its picture, name and family.

    The Tab key stops at the first of them alone.

    address  of PICTURES on the page. All buttons show parts of that one file.
    text     that was looked for: where a material looks like a word of it, this word takes the
             place of the family
    """
    like = {name: word for word in asked_words(text) for name in ALIKE.get(word, ())}
    places = {name: number for number, name in enumerate(families())}
    buttons = []
    for number, name in enumerate(names):
        row, column = divmod(places[name], COLUMNS)
        place = f"{-TILE * column}px {-TILE * row}px"
        style = f"background: url('{address}') {place}"
        shown = html.escape(name)
        note = f"looks like {like[name]}" if name in like else families()[name]
        stop = 0 if number == 0 else -1
        buttons.append(
            f'<button data-name="{shown}" tabindex="{stop}">'
            f'<span class="picture" style="{html.escape(style)}"></span>'
            f'<span class="caption">{shown}</span>'
            f'<span class="note">{html.escape(note)}</span></button>'
        )
    label = "Materials. Arrow keys go from one to the next."
    return f'<div class="tiles" role="group" aria-label="{label}">{"".join(buttons)}</div>'


def search(text: str) -> list[str]:
    """Return names of the materials of which each word of a text begins a word; all for none.

    Materials that a word names, or is known to look like, come before those of its family.
    """
    asked = asked_words(text)
    matching = [name for name in words() if all(begins_word(name, word) for word in asked)]
    return ordered(matching, asked) if asked else matching


def found_by(text: str) -> tuple[list[str], str]:
    """Return names of the materials that a search shows, and a line about them."""
    matching = search(text)
    if matching:
        return matching, number_of(len(matching), "material")
    close = close_to(text)
    rest = "These are close:"
    if not close:
        rest = (
            "Try a colour, or wood, metal, fabric, plastic, stone; or mix one under “A material of"
            " your own”."
        )
    return close, f"No material is called “{text.strip()[:40]}”. {rest}"


def close_to(text: str) -> list[str]:
    """Return names of the materials that come near a text that `search` finds nothing for.

    A word that no material has, but that some look like, stands for the families of those: blue
    velvet for fabrics that are blue. Where that has no result either, materials of the most words
    come first.
    """
    asked = asked_words(text)
    alike = {word: {families()[name] for name in ALIKE.get(word, ())} for word in asked}

    def matches(name: str, word: str) -> bool:
        return begins_word(name, word) or families()[name] in alike[word]

    all_of_them = [name for name in words() if all(matches(name, word) for word in asked)]
    if all_of_them:
        return ordered(all_of_them, asked)
    counts = {name: sum(begins_word(name, word) for word in asked) for name in words()}
    some = ordered([name for name, count in counts.items() if count], asked)
    return sorted(some, key=lambda name: -counts[name])


def asked_words(text: str) -> list[str]:
    """Return the words of a text in lower case, without a plural's s."""
    return [word.rstrip("s") or word for word in re.split(r"[\s,_-]+", text.lower()) if word]


def begins_word(name: str, word: str) -> bool:
    """Return whether a word begins one of the words by which a material is looked for."""
    return any(each.startswith(word) for each in words()[name].split())


def ordered(names: list[str], asked: list[str]) -> list[str]:
    """Return names in the order in which they answer the words that were asked for.

    A name that is one of the words comes first, then those that have all words, then those that
    look like one of them.
    """
    alike = [name for word in asked for name in ALIKE.get(word, ())]

    def order(name: str) -> tuple[bool, bool, int]:
        named = all(word in name.lower() for word in asked)
        return name not in asked, not named, alike.index(name) if name in alike else len(alike)

    return sorted(names, key=order)


def draw() -> Path:
    """Draw the pictures of all materials and return their file."""
    from learn.figures import spheres
    from shaders.frames import ELEVATION

    names = families()
    rows = -(-len(names) // COLUMNS)
    picture = np.full((rows * TILE, COLUMNS * TILE, 3), 255.0)
    disk = (spheres.sphere_normals(2 * TILE) != 0).any(-1).reshape(TILE, 2, TILE, 2).mean((1, 3))
    for number, name in enumerate(names):
        row, column = divmod(number, COLUMNS)
        label = targets.label_of(name)
        sphere = spheres.preview_sphere(label, 2 * TILE, float(ELEVATION))
        small = sphere.reshape(TILE, 2, TILE, 2, 3).mean((1, 3))
        place = picture[row * TILE :, column * TILE :][:TILE, :TILE]
        place[:] = small + 255.0 * (1 - disk[..., None])
    files.write_image(PICTURES, picture.clip(0, 255).astype(np.uint8), "JPEG", quality=QUALITY)
    return PICTURES


if __name__ == "__main__":
    print(draw())
