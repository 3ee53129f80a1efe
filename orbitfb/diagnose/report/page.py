"""The report of a diagnosis: one HTML page with its pictures inside, no network."""

from orbitfb.diagnose.answer import Diagnosis
from orbitfb.diagnose.report import answer_sections, evidence_sections
from orbitfb.diagnose.report.html import STYLE, paragraph, text

_CONTENTS = (
    ("causes", "causes"),
    ("gap", "gap"),
    ("tournament", "tournament"),
    ("places", "ring"),
    ("fingerprints", "fingerprints"),
    ("shrink", "shrink"),
    ("predictions", "predictions"),
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
    body = [
        "<h1>Diagnosis</h1>",
        paragraph(source, "source"),
        answer_sections.card(its),
    ]
    if its.failed:
        body += [answer_sections.findings(its), answer_sections.provenance(its)]
    else:
        links = "".join(f'<a href="#{anchor}">{word}</a>' for anchor, word in _CONTENTS)
        body += [
            f"<nav>{links}</nav>",
            answer_sections.findings(its),
            answer_sections.causes(its),
            evidence_sections.gap(its),
            evidence_sections.tournament(its),
            evidence_sections.places(its),
            evidence_sections.fingerprints(its),
            evidence_sections.shrinking(its),
            evidence_sections.predictions(its),
            evidence_sections.limits(its),
            answer_sections.experiment(its),
            evidence_sections.audit(its),
            answer_sections.provenance(its),
        ]
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        '<meta http-equiv="Content-Security-Policy" content="default-src \'none\'; '
        "img-src data:; style-src 'unsafe-inline'\">"
        f"<title>Diagnosis: {source}</title><style>{STYLE}</style></head>\n<body>\n"
        + "\n".join(piece for piece in body if piece)
        + "\n</body></html>\n"
    )
