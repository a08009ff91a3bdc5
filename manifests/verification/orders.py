"""Which records and views the jobs in dataset.json ask for: their seeds, views and rotations follow from the job.

combination  one shape, its materials and a light; what a job leaves to chance is drawn once for each
             (manifests.ids.draws), and each record's seed is a hash of its combination's word and its place
"""

from collections.abc import Iterator, Sequence

from manifests import ids
from manifests.schema import Dataset, Draw, Job, Record, View

MOST_CHOICES = 16  # draws of materials whose seeds are tried; of more, seeds are not looked at (each try takes 20 µs)


class Orders:
    """The orders of a data set. `met`: indices of those that a record or a view has been found for."""

    def __init__(self, dataset: Dataset):
        self.jobs = [order.job for order in dataset.orders]
        self.met: set[int] = set()

    def combinations(self, record: Record, materials: Sequence[str]) -> list["Combination"]:
        """The jobs that may have asked for records like this one, drawn for its combination; materials: their hashes."""
        return [
            Combination(index, job, record.shape_hash, materials, record.light_hash)
            for index, job in enumerate(self.jobs)
            if job.pictures and job.camera == record.camera and job.samples == record.samples
        ]

    def ask_for(self, record: Record, combinations: list["Combination"]) -> bool:
        """Whether a job asks for a record; combinations: as `combinations` gives them for it."""
        for combination in combinations:
            if combination.holds(record):
                self.met.add(combination.index)
                return True
        return False

    def ask_for_view(self, view: View) -> bool:
        """Whether a job without pictures asks for a view."""
        for index, job in enumerate(self.jobs):
            if job.pictures or job.camera != view.camera:
                continue
            if view.viewpoint in ids.views_alone(job, view.shape_hash):
                self.met.add(index)
                return True
        return False

    @property
    def unmet(self) -> list[int]:
        """Indices of the orders for which nothing has been found so far."""
        return [index for index in range(len(self.jobs)) if index not in self.met]


class Combination:
    """What a job draws for one combination: words of its seeds with their views, drawn when they are first needed."""

    def __init__(self, index: int, job: Job, shape_hash: str, materials: Sequence[str], light_hash: str):
        self.index, self.job = index, job
        self._tiers, self._resolutions = set(job.tiers), set(job.light_resolutions)
        self._drawn: list[tuple[int, dict[int, frozenset[int]]]] = []
        self._rest = self._draws(shape_hash, materials, light_hash)
        self._too_many = (job.segment_materials or 0) > MOST_CHOICES

    def holds(self, record: Record) -> bool:
        """Whether the job asks for a record of this combination."""
        job, view, turn = self.job, record.viewpoint, record.rotation_texels
        if record.tier not in self._tiers or record.light_resolution not in self._resolutions:
            return False
        if self._too_many:
            in_views = isinstance(job.views, Draw) or view in job.views
            return in_views and (isinstance(job.rotations, Draw) or turn in job.rotations)
        place = (view, turn, record.tier, record.light_resolution)
        return any(
            turn in turns.get(view, ()) and any(ids.shot_seed(word, ids.shot_place(*place, k)) == record.seed for k in range(job.repeats))
            for word, turns in self._every()
        )

    def _every(self) -> Iterator[tuple[int, dict[int, frozenset[int]]]]:
        """The draws made so far, then the others."""
        yield from list(self._drawn)
        for drawn in self._rest:
            self._drawn.append(drawn)
            yield drawn

    def _draws(self, shape_hash, materials, light_hash):
        """(word, {view: rotations}) of each time that the job names the light, and of each draw of materials."""
        choices = (None,) if self.job.segment_materials is None else range(min(self.job.segment_materials, MOST_CHOICES))
        for occurrence in range(len(self.job.lights)):
            for choice in choices:
                key = ids.combination_key(shape_hash, materials, light_hash, occurrence, choice)
                word, views, turns = ids.draws(self.job, key)
                yield word, dict(zip(views, map(frozenset, turns), strict=True))
