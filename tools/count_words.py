"""Words of the pages by group of the site's navigation: python tools/count_words.py."""

import re
import sys
from pathlib import Path

DOCS = Path(__file__).resolve().parent.parent / "docs"
TOCTREE = re.compile(r"```\{toctree\}\n:hidden:\n(?::caption: ([^\n]*)\n)?\n(.*?)```", re.DOTALL)
EVIDENCE = "Evidence"


def groups(index: Path) -> dict[str, list[Path]]:
    """Pages that the navigation of an index page lists, by the caption of their group; without one, `EVIDENCE`."""
    return {
        caption or EVIDENCE: [(index.parent / f"{name}.md").resolve() for name in listed.split()]
        for caption, listed in TOCTREE.findall(index.read_text(encoding="utf-8"))
    }


def words() -> dict[str, dict[str, int]]:
    """Words of every page that is in the repository, by the caption of its group in the index."""
    found = groups(DOCS / "index.md")
    found[EVIDENCE] += groups(DOCS / "evidence" / "index.md")[EVIDENCE]
    return {
        caption: {
            str(page.relative_to(DOCS)): sum(map(is_word, page.read_text(encoding="utf-8").split()))
            for page in pages
            if page.exists() and "reference" not in page.parts
        }
        for caption, pages in found.items()
    }


def for_users() -> int:
    """Words of all pages outside the evidence."""
    return sum(sum(pages.values()) for caption, pages in words().items() if caption != EVIDENCE)


def is_word(text: str) -> bool:
    """Whether a piece of text between blanks is one: bars of tables, fences and dashes are not."""
    return any(map(str.isalnum, text))


def main() -> None:
    """Print the words of each page, each group, and of all pages for users."""
    for caption, pages in words().items():
        sys.stdout.write(f"{sum(pages.values()):7d}  {caption}\n")
        sys.stdout.writelines(f"{count:7d}    {page}\n" for page, count in pages.items())
    sys.stdout.write(f"{for_users():7d}  for users\n")


if __name__ == "__main__":
    main()
