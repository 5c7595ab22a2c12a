"""What the pages of measured numbers share: which are asked for, and the blocks between marks."""

import argparse


def asked(what, names, doc):
    """Return which of some names are asked for on the command line, all if none; none by --page.

    Args:
        what: they are, a word: ``search``.
        names: all there are.
        doc: of the program.
    """
    parser = argparse.ArgumentParser(description=doc.splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(names)}")
    parser.add_argument("--page", action="store_true", help="run nothing, write the page")
    given = parser.parse_args()
    if wrong := [name for name in given.names if name not in names]:
        parser.error(f"no {what} {wrong[0]!r}; there are {', '.join(names)}")
    return [] if given.page else given.names or list(names)


def write_blocks(page, blocks):
    """Write the blocks of a page anew, each between its marks.

    Args:
        page: pathlib.Path of it.
        blocks: text by name.
    """
    text = page.read_text(encoding="utf-8")
    for name, written in blocks.items():
        begin, end = f"<!-- {name} -->", f"<!-- end of {name} -->"
        head, rest = text.split(begin)
        _, tail = rest.split(end)
        text = f"{head}{begin}\n{written}\n{end}{tail}"
    page.write_text(text, encoding="utf-8")
