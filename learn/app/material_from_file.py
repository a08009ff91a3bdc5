"""Materials that a user sends to the page: another picture's object, or a material.json."""

from pathlib import Path

from learn.app.choices import Chosen
from learn.app.session import Session
from learn.editing import decomposition, material_file, photograph
from learn.refinement import PHOTOGRAPHS
from manifests.errors import InputError


def materials_of(session: Session, sent: Path, number: int) -> dict[int, Chosen]:
    """Return {region: material} of another picture's object, or of a material.json.

    number  of the region that a single material is for; a file of several has one for each region,
            as `brdfactory edit` takes it
    Raises  InputError: no picture with transparency, no material, another number of them
    """
    name = sent.name
    if sent.suffix.lower() == ".json":
        labels, were = material_file.read_with_origin(sent)
        count = len(session.decomposed()[1].regions)
        if len(labels) not in (1, count):
            rule = (
                "one material" if count == 1 else f"one material, or {count}: one for each region"
            )
            remedy = "give the photograph these regions, or keep one label in the file"
            raise InputError(sent, rule, f"{len(labels)}", remedy)
        if len(labels) > 1:
            return {
                region: Chosen(f"{name}, region {region}", label, named=False, read=read)
                for region, (label, read) in enumerate(zip(labels, were, strict=True), 1)
            }
        return {number: Chosen(name, labels[0], named=False, read=were[0])}
    opened = photograph.from_arrays(sent, name=name)
    network, metadata = session.network.loaded()
    settings = PHOTOGRAPHS if session.refined else None
    label = decomposition.decompose(opened, network, metadata["size"], settings).label[0]
    return {number: Chosen(name, label, named=False, read=True)}
