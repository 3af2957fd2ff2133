"""Judge the external links of the site: ``python docs/making/links.py docs/_build/links/output.json``.

In:  the file that sphinx's builder ``linkcheck`` writes.
Out: a line for each link that is broken or redirected, and the number tried; exit code 1 if one is broken, 3 if none
     could be reached, which indicates a missing network rather than broken links.
"""

import json
import re
import sys
from pathlib import Path

UNREACHED = re.compile(
    r"NameResolutionError|getaddrinfo|Temporary failure|Name or service|No address|Network is "
    r"unreachable|ConnectTimeout|Max retries"
    r"|ProxyError|timed out|Connection refused",
    re.I,
)


def judged(lines: list[str]) -> tuple[list[str], int]:
    """Return the lines to print about the links, and the exit code."""
    rows = [json.loads(line) for line in lines if line.strip()]
    tried = [row for row in rows if row["status"] not in ("unchecked", "local", "ignored")]
    broken = [row for row in tried if row["status"] in ("broken", "timeout", "rate-limited")]
    if (
        tried
        and len(broken) == len(tried)
        and all(row["status"] == "timeout" or UNREACHED.search(row["info"]) for row in broken)
    ):
        return [
            f"none of {len(tried)} links could be reached: there is no network connection, so nothing is known "
            f"about them"
        ], 3
    said = [
        f"{row['filename']}:{row['lineno']}: {row['uri']} is {row['status']}: {' '.join(row['info'].split())[:150]}"
        for row in broken
    ]
    said += [
        f"{row['filename']}:{row['lineno']}: {row['uri']} leads to {row['info']}"
        for row in tried
        if row["status"] == "redirected"
    ]
    return [*said, f"{len(tried)} links tried, {len(broken)} broken"], 1 if broken else 0


if __name__ == "__main__":
    path = Path(sys.argv[1])
    if not path.exists():
        raise SystemExit(f"{path} does not exist; run: sphinx-build -b linkcheck docs {path.parent}")
    told, code = judged(path.read_text().splitlines())
    print(*told, sep="\n")
    raise SystemExit(code)
