"""Text of others neither forges a line nor steers a terminal."""

import pytest

from orbitfb.core.printable import escaped, plain


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("orbit rms 0.2 µm – Größe", "orbit rms 0.2 µm – Größe"),
        ("a\n0:00:00 CLOSED", "a\\n0:00:00 CLOSED"),
        ("\x1b[2J", "\\x1b[2J"),
        ("a\u202eb\x9b", "a\\u202eb\\x9b"),
    ],
)
def test_what_cannot_be_printed_is_written_out(text: str, shown: str):
    assert escaped(text) == shown
    assert escaped(text).isprintable()


@pytest.mark.parametrize("name", ["operator", "jürgen", "x\n\x1b[2J", "\U0001f600" * 100, ""])
def test_a_claimed_name_is_short_and_of_printable_ascii(name: str):
    shown = plain(name, 60)
    assert len(shown) <= 60
    assert shown.isascii()
    assert shown.isprintable()
    assert shown == name or not name.isascii() or not name.isprintable()
