"""Text of others on our terminals and in our logs: what cannot be printed is written out."""


def escaped(text: str) -> str:
    r"""Write out what cannot be printed: a line feed becomes `\n`, ESC `\x1b`.

    A name that somebody claims, or a text of a PV, can then neither forge a line nor steer a
    terminal.

    Args:
        text: Of anybody.
    """
    return text if text.isprintable() else "".join(map(_sign, text))


def plain(text: str, longest: int) -> str:
    """Write out what is no printable ASCII, and keep it short: names as clients claim them.

    Args:
        text: Of anybody.
        longest: Most characters that are kept.
    """
    head = text[:longest]
    if head.isascii() and head.isprintable():
        return head
    signs = (each if each.isascii() and each.isprintable() else _written(each) for each in head)
    return "".join(signs)[:longest]


def _sign(sign: str) -> str:
    return sign if sign.isprintable() else _written(sign)


def _written(sign: str) -> str:
    return sign.encode("unicode_escape").decode()
