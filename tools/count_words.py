"""Words of the pages by group of the site's navigation: python tools/count_words.py."""

import re
import sys
from pathlib import Path

DOCS = Path(__file__).resolve().parent.parent / "docs"
GROUP = re.compile(r":caption: (.*?)\n\n(.*?)```", re.DOTALL)
BACKGROUND = "Background and evidence"


def words() -> dict[str, dict[str, int]]:
    """Words of every page that is in the repository, by the caption of its group in the index."""
    found: dict[str, dict[str, int]] = {}
    for caption, listed in GROUP.findall((DOCS / "index.md").read_text(encoding="utf-8")):
        pages = [DOCS / f"{name}.md" for name in listed.split()]
        found[caption] = {
            str(page.relative_to(DOCS)): sum(map(is_word, page.read_text(encoding="utf-8").split()))
            for page in pages
            if page.exists() and "reference" not in page.parts
        }
    return found


def is_word(text: str) -> bool:
    """Whether a piece of text between blanks is one: bars of tables, fences and dashes are not."""
    return any(map(str.isalnum, text))


def main() -> None:
    """Print the words of each page, each group, and of all pages for users."""
    total = 0
    for caption, pages in words().items():
        sys.stdout.write(f"{sum(pages.values()):7d}  {caption}\n")
        sys.stdout.writelines(f"{count:7d}    {page}\n" for page, count in pages.items())
        total += sum(pages.values()) * (caption != BACKGROUND)
    sys.stdout.write(f"{total:7d}  for users\n")


if __name__ == "__main__":
    main()
