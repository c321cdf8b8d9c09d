"""`python -m reference`: write all pages of docs/reference, and remove those that are no longer made."""

from __future__ import annotations

from reference.pages import FOLDER, pages

if __name__ == "__main__":
    made = pages()
    for file in FOLDER.rglob("*.md"):
        if file.relative_to(FOLDER).as_posix() not in made:
            file.unlink()
    for name, text in made.items():
        (FOLDER / name).parent.mkdir(parents=True, exist_ok=True)
        (FOLDER / name).write_text(text, encoding="utf-8")
    print(f"{len(made)} pages in {FOLDER}")
