"""README and docs: short where they should be, and their links lead somewhere."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
DOCUMENTS = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


def anchors(document: Path) -> set[str]:
    """Of its headings, as GitHub makes them."""
    headings = re.findall(r"^#+ (.+)$", document.read_text("utf-8"), re.MULTILINE)
    return {
        re.sub(r"[^\w -]", "", heading).strip().lower().replace(" ", "-") for heading in headings
    }


def test_the_first_page_is_short() -> None:
    assert len((ROOT / "README.md").read_text("utf-8").splitlines()) <= 110


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda document: document.name)
def test_links_lead_somewhere(document: Path) -> None:
    links = re.findall(r"\]\((?!https?:)([^)]+)\)", document.read_text("utf-8"))
    for link in links:
        name, _, anchor = link.partition("#")
        target = document.parent / name if name else document
        assert target.exists(), link
        assert not anchor or anchor in anchors(target), link


def test_every_document_is_linked_from_the_first_page() -> None:
    first = (ROOT / "README.md").read_text("utf-8")
    assert not [document.name for document in DOCUMENTS[1:] if f"docs/{document.name}" not in first]


def rows(document: str, heading: str) -> list[list[str]]:
    """The cells of the first table below a heading."""
    below = (ROOT / "docs" / document).read_text("utf-8").split(f"## {heading}\n", 1)[1]
    table = re.search(r"(?:^\|.*\n)+", below, re.MULTILINE)
    assert table
    return [
        [cell.strip() for cell in line.strip("|").split("|")]
        for line in table.group().splitlines()[2:]
    ]


def test_the_first_page_states_the_measured_figures() -> None:
    for name, title in (("named", "8 kinds of buildings"), ("drawn", "12 buildings drawn")):
        text = (ROOT / "docs" / "measured.md").read_text("utf-8")
        table = text.split(f"<!-- table {name} -->\n")[1].split("<!-- end -->")[0]
        mean = next(line for line in table.splitlines() if "mean, or sum" in line).split(" | ")
        first = (ROOT / "README.md").read_text("utf-8")
        stated = re.search(rf"^\| {title}.*(?= \|$)", first, re.MULTILINE)[0].split(" | ")
        found, passed = map(int, mean[7].split(" of "))
        assert stated[1:5] == [mean[1].split(" / ")[2], *mean[2:5]]
        assert stated[5:] == [f"{100 * found / passed:.1f}", mean[11].strip(" |")]


def test_each_part_of_the_paper_has_its_file() -> None:
    table = rows("method.md", "Sections of the paper")
    told = " ".join(paper for paper, _, _ in table)
    for part in (
        "eq. 1",
        "eq. 2",
        "eq. 3",
        "Algorithm 1",
        "Table I",
        "Table II",
        *(f"Fig. {n}" for n in range(1, 11)),
    ):
        assert re.search(rf"{re.escape(part)}(?![0-9I])", told), part
    for paper, _, file in table:
        text = (ROOT / file.strip("`")).read_text("utf-8")
        # The file says so itself, in the paper's own numbers.
        for number in re.findall(r"eq\. \d|Algorithm \d", paper):
            assert number in text, f"{file} does not name {number}"
        assert text.startswith('"""'), file


def test_each_folder_is_told() -> None:
    told = {folder.strip("`") for folder, _ in rows("method.md", "Folders")}
    for folder in told:
        assert (ROOT / folder).is_dir(), folder
    rooms = {
        path.parent.relative_to(ROOT).as_posix()
        for top in ("algorithms", "app")
        for path in (ROOT / top).glob("*/*.py")
    }
    assert rooms <= told
