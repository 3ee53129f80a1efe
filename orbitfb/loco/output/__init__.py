"""The files of an answer: tables, page with pictures, effects of a simulated ring."""
