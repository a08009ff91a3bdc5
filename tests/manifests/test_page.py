"""The demo's page: everything on it comes from files on disk.

What is missing is reported in one line.
"""

import json
import re

import pytest

from learn.agreement import demo_page

FIGURES = {
    "pictures": 4,
    "l2": 1.25,
    "noise": 0.75,
    "net": 0.5,
    "ssim": 0.9991,
    "signed": -0.0123,
    "absolute": 0.02,
    "node_fit": None,
}

MISSED = {
    "net": 0.9,
    "like_net": 0.7,
    "like_net_error": 0.1,
    "noise_may_decide": True,
    "node_fit": 0.4,
    "limit": 1.5,
    "holds": False,
}


ABOUT = {"command": "learn agree a & b", "versions": {"numpy": "1.26", "bpy": "4.5"}}


@pytest.fixture
def agreement(tmp_path):
    """A folder as `learn agree` leaves it."""
    folder = tmp_path / "agreement"
    folder.mkdir()
    summary = {
        "direct": {"net": 7.5, "like_net": 0.5, "node_fit": 0.4, "limit": 1.5, "holds": True},
        "causes": {"edges": 0.321, "noise": 0.75, "look_up_texels": {"median": 0.1}},
        "breakdowns": {"material": {"<brass>": FIGURES}, "highlight": {"wide": FIGURES}},
    }
    (folder / "report.json").write_text(json.dumps({"about": ABOUT, "summary": summary}))
    (folder / "causes.png").write_bytes(b"")
    return folder


def run(out, agreement, *sheets):
    return demo_page.main(
        [
            "--out",
            str(out),
            "--agreement",
            str(agreement),
            *(f"--sheet={sheet}" for sheet in sheets),
        ]
    )


def test_the_page_shows_the_figures_of_the_report_and_escapes_names(tmp_path, agreement):
    out = tmp_path / "index.html"
    assert run(out, agreement) == 0
    text = out.read_text()
    assert "&lt;brass&gt;" in text and "<brass>" not in text and "a &amp; b" in text
    assert "numpy 1.26, bpy 4.5" in text and "{" not in re.sub(
        r"<style>.*?</style>", "", text, flags=re.S
    )
    for shown in ("0.9991", "-1.23%", "2.00%", "within it", "0.321"):
        assert shown in text
    assert "node fit L2" not in text  # no figure, no column
    assert "highlight" not in text  # that breakdown is the report's alone


def test_every_link_of_the_page_leads_from_its_own_folder_to_a_file(tmp_path, agreement):
    (agreement / "index.html").write_text("")
    sheet = tmp_path / "sheets" / "sheet one.png"
    sheet.parent.mkdir()
    sheet.write_bytes(b"")
    out = tmp_path / "site" / "index.html"
    assert run(out, agreement, sheet) == 0
    links = re.findall(r"(?:href|src)='([^']+)'", out.read_text())
    assert len(links) == 5 and all((out.parent / link).is_file() for link in links)


@pytest.mark.parametrize(
    ("direct", "word"),
    [
        (MISSED, "of 0.70 ± 0.10 (limit 0.60) inside silhouettes"),
        (MISSED, "the difference is beyond it. Noise may have decided this"),
        # a report that an earlier version wrote
        ({key: MISSED[key] for key in ("net", "like_net", "node_fit", "limit")}, "of 0.7 (limit"),
        ({"net": None, "node_fit": 0.4}, "cannot be judged"),
        ({"net": 0.9, "like_net": 0.7, "node_fit": None}, "no limit"),
    ],
)
def test_the_verdict_says_what_the_report_found(direct, word):
    assert word in demo_page.verdict(direct)


def test_what_is_missing_or_damaged_is_told_in_one_line_and_no_page_is_left(
    tmp_path, agreement, capsys
):
    out = tmp_path / "index.html"
    assert run(out, agreement, tmp_path / "none.png") == 1
    (agreement / "report.json").write_text("{")
    assert run(out, agreement) == 1
    (agreement / "report.json").unlink()
    assert run(out, agreement) == 1
    report = capsys.readouterr().err.splitlines()
    assert (
        len(report) == 3
        and "none.png" in report[0]
        and "expected JSON" in report[1]
        and "learn agree" in report[2]
    )
    assert not out.exists()


def test_predictions_stand_on_the_page_with_what_they_are_and_without_any_nothing_is_said_of_them(
    tmp_path, agreement
):
    sheet = tmp_path / "parts" / "sheet.png"
    sheet.parent.mkdir()
    sheet.write_bytes(b"")
    shown = demo_page.demo_page(tmp_path / "index.html", [], agreement, "t", [sheet])
    assert "What the network reads" in shown
    assert "href='parts/sheet.png'" in shown
    assert "What the network reads" not in demo_page.demo_page(
        tmp_path / "index.html", [], agreement, "t"
    )


def test_a_prediction_that_is_not_there_is_told(tmp_path, agreement, capsys):
    arguments = [
        "--out",
        str(tmp_path / "index.html"),
        "--agreement",
        str(agreement),
        "--prediction",
        str(tmp_path / "gone.png"),
    ]
    assert demo_page.main(arguments) == 1
    assert "gone.png" in capsys.readouterr().err
    assert not (tmp_path / "index.html").exists()


def test_what_a_user_came_for_stands_first_and_how_the_page_was_made_last(tmp_path, agreement):
    sheet = tmp_path / "sheet.png"
    sheet.write_bytes(b"")
    text = demo_page.demo_page(tmp_path / "index.html", [sheet], agreement, "t", [sheet], [sheet])
    headings = re.findall("<h2>(.*?)</h2>", text)
    assert [heading.split()[0] for heading in headings] == ["Edits:", "What", "The", "Do", "How"]
    assert text.index("a &amp; b") > text.index(headings[-1])


def test_edits_stand_on_the_page_only_where_there_are_some(tmp_path, agreement, capsys):
    out, edit = tmp_path / "index.html", tmp_path / "edit.png"
    edit.write_bytes(b"")
    assert run(out, agreement) == 0 and "another material" not in out.read_text()
    assert (
        demo_page.main(["--out", str(out), "--agreement", str(agreement), "--edit", str(edit)]) == 0
    )
    assert "another material" in out.read_text() and "src='edit.png'" in out.read_text()
    assert (
        demo_page.main(
            ["--out", str(out), "--agreement", str(agreement), "--edit", str(tmp_path / "gone.png")]
        )
        == 1
    )
    assert "gone.png" in capsys.readouterr().err
