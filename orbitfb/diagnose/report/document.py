"""The report of a diagnosis: one HTML page with its pictures inside, no network."""

from orbitfb.diagnose.report import evidence, limits, opening, orbit
from orbitfb.diagnose.result.diagnosis import Diagnosis
from orbitfb.html.page import STYLE, paragraph, text

_CONTENTS = (
    ("causes", "causes"),
    ("orbit", "orbit"),
    ("gap", "where"),
    ("evidence", "evidence"),
    ("limits", "limits"),
    ("experiment", "experiment"),
    ("audit", "audit"),
    ("provenance", "provenance"),
)


def page(its: Diagnosis) -> str:
    """Write the page.

    Nothing in it can run or fetch: no scripts, no links but to its own sections, every text that
    a record may have brought is escaped, and a policy in the page forbids all else.
    """
    source = text(its.provenance.source) or text(its.provenance.data_sha256[:12])
    body = ["<h1>Diagnosis</h1>", paragraph(source, "source"), opening.card(its)]
    if its.failed:
        body += [opening.findings(its), limits.provenance(its)]
    else:
        links = "".join(f'<a href="#{anchor}">{word}</a>' for anchor, word in _CONTENTS)
        body += [
            f"<nav>{links}</nav>",
            opening.findings(its),
            opening.causes(its),
            orbit.orbit(its),
            orbit.where(its),
            evidence.evidence(its),
            limits.limits(its),
            opening.experiment(its),
            limits.audit(its),
            limits.provenance(its),
        ]
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        '<meta name="color-scheme" content="light dark">'
        '<meta http-equiv="Content-Security-Policy" content="default-src \'none\'; '
        "img-src data:; style-src 'unsafe-inline'\">"
        f"<title>Diagnosis: {source}</title><style>{STYLE}</style></head>\n<body>\n"
        + "\n".join(piece for piece in body if piece)
        + "\n</body></html>\n"
    )
