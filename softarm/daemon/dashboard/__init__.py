"""The page at `GET /`: HTML, JavaScript and CSS, which a browser takes as they lie here; no code of ours runs here."""
