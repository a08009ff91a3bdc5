"""All pages of the site that are made from code and from results.

`docs/hooks.py` adds them when the site is built; none is in the repository.
"""

from pathlib import Path

from site_commands import command_page, experiments_page
from site_reference import brdfactory_page, layer_page, schemas_page, shaders_page
from site_results import gallery, jobs_page, reports_page, weights_page

from manifests import publish


def all_files(root: Path) -> dict[str, str | bytes]:
    """Return {path in the site: contents} of everything that is made; root: the repository."""
    results = root / "docs" / "results"
    made: dict[str, str | bytes] = {
        "reference/command-line.md": command_page(),
        "reference/experiments.md": experiments_page(),
        "reference/brdfactory.md": brdfactory_page(),
        "reference/layer.md": layer_page(),
        "reference/shaders.md": shaders_page(),
        "reference/schemas.md": schemas_page(),
        "results/index.md": reports_page(results),
        "results/weights.md": weights_page(root / "learn" / "weights"),
        "jobs/index.md": jobs_page(root / "docs" / "jobs"),
    }
    for name, text in publish.documents().items():
        made[f"reference/{name}"] = text
    return made | gallery(results / "photographs")
