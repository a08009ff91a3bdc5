"""Records and views, checked against the jobs in dataset.json that ask for them.

combination  one shape, its materials and a light. What a job leaves to chance is drawn once for
             each (manifests.ids.draws), and each record's seed is a hash of its combination's word
             and its place.
"""

from collections.abc import Iterator, Sequence

from manifests import ids
from manifests.schema import Dataset, Draw, Job, Record, View
from manifests.verification.faults import Fault, Line

# draws of materials whose seeds are tried; of more, seeds are not looked at (each try takes 20 µs)
MOST_CHOICES = 16
MOST_COMBINATIONS = 20_000  # that are remembered; the records of one are neighbours


class Orders:
    """The orders of a data set; lines are compared one by one, and the faults come at the end."""

    def __init__(self, dataset: Dataset):
        self._dataset = dataset
        self._jobs = [order.job for order in dataset.orders]
        self._met: set[int] = set()
        self._combinations: dict[tuple, list[Combination]] = {}
        self._unasked: list[Fault] = []

    def look(self, line: Record | View, place: Line) -> None:
        """Note whether an order asks for a record or a view.

        place  its file and line number
        """
        if self._is_asked(line):
            return
        kind = "record" if isinstance(line, Record) else "view"
        text = f"{kind} {line.id}: expected an order in dataset.json that asks for it, found none"
        self._unasked.append(Fault(text, line.id, place))

    def _is_asked(self, line):
        if isinstance(line, View):
            for index, job in enumerate(self._jobs):
                if (
                    not job.pictures
                    and ids.camera_of(job, line.shape_hash, line.viewpoint) == line.camera
                    and line.viewpoint in ids.views_alone(job, line.shape_hash)
                ):
                    self._met.add(index)
                    return True
            return False
        for combination in self._combinations_of(line):
            if combination.holds(line):
                self._met.add(combination.index)
                return True
        return False

    def _combinations_of(self, record):
        """Return the jobs that may have asked for a record, drawn for its combination."""
        key = (
            record.shape_hash,
            record.materials,
            record.light_hash,
            record.camera,
            ids.sampling(record),
        )
        if key not in self._combinations:
            if len(self._combinations) >= MOST_COMBINATIONS:
                self._combinations.clear()
            entries = [self._dataset.materials.get(name) for name in record.materials]
            hashes = [entry.hash for entry in entries if entry]
            self._combinations[key] = [
                Combination(index, job, record.shape_hash, hashes, record.light_hash)
                for index, job in enumerate(self._jobs)
                if job.pictures
                and (job.camera_ranges or job.camera == record.camera)
                and ids.sampling(job) == ids.sampling(record)
            ]
        return self._combinations[key]

    def faults(self) -> Iterator[Fault]:
        """Yield the lines that no order asks for.

        If there is an order without lines, its job may have been altered, and the order is the
        fault.
        """
        if self._unasked and self._jobs and len(self._met) == len(self._jobs):
            yield from self._unasked
        elif self._unasked:
            many, first = len(self._unasked), self._unasked[0].record
            remedy = "the same `render` writes its order down again"
            yield Fault(
                f"dataset.json: expected orders that ask for all lines, found none for {many},"
                f" {first} first ({remedy})"
            )


class Combination:
    """What a job draws for one combination: words of seeds with their views, drawn on demand."""

    def __init__(
        self, index: int, job: Job, shape_hash: str, materials: Sequence[str], light_hash: str
    ):
        self.index, self.job, self._shape_hash = index, job, shape_hash
        self._tiers, self._resolutions = set(job.tiers), set(job.light_resolutions)
        self._drawn: list[tuple[int, dict[int, frozenset[int]]]] = []
        self._rest = self._draws(shape_hash, materials, light_hash)
        self._too_many = (job.segment_materials or 0) > MOST_CHOICES

    def holds(self, record: Record) -> bool:
        """Return whether the job asks for a record of this combination."""
        job, view, turn = self.job, record.viewpoint, record.rotation_texels
        if record.tier not in self._tiers or record.light_resolution not in self._resolutions:
            return False
        if ids.camera_of(job, self._shape_hash, view) != record.camera:
            return False
        if self._too_many:
            in_views = isinstance(job.views, Draw) or view in job.views
            return in_views and (isinstance(job.rotations, Draw) or turn in job.rotations)
        place = (view, turn, record.tier, record.light_resolution)
        return any(
            turn in turns.get(view, ())
            and any(
                ids.shot_seed(word, ids.shot_place(*place, k)) == record.seed
                for k in range(job.repeats)
            )
            for word, turns in self._every()
        )

    def _every(self) -> Iterator[tuple[int, dict[int, frozenset[int]]]]:
        """Yield the draws made so far, then the others."""
        yield from list(self._drawn)
        for drawn in self._rest:
            self._drawn.append(drawn)
            yield drawn

    def _draws(self, shape_hash, materials, light_hash):
        """Yield (word, {view: rotations}) of each occurrence of the light and draw of materials."""
        choices = (
            (None,)
            if self.job.segment_materials is None
            else range(min(self.job.segment_materials, MOST_CHOICES))
        )
        for occurrence in range(len(self.job.lights)):
            for choice in choices:
                key = ids.combination_key(shape_hash, materials, light_hash, occurrence, choice)
                word, views, turns = ids.draws(self.job, key)
                yield word, dict(zip(views, map(frozenset, turns), strict=True))
