"""URIs that a hostile document may give: a grammar of ways out of its folder, and of odd names."""

from __future__ import annotations

from random import Random

SECRET = b"SKINBAKE-SECRET: this was outside of the folder of the model"
"""The content of files that no run may read: if it turns up in an output, something was let out."""

PLAIN = ("m.bin", "tex.png", "sub/tex.png", "x#/tex.png", "a b.png", "ä.png")
UPWARDS = ("..", "%2e%2e", "%2E.", ".%2e", "..%2f..", "..%5c..", "..\\..", "%252e%252e", "....", "...")
INWARDS = (
    ".",
    "",
    "sub",
    "x#",
    "x%23",
    "x?",
    "link",
    "%6cink",
    "a b",
    "ä",
    "%c3%a4",
    "%ff",
    "CON",
    "nul.txt",
)
SECRETS = ("secret.bin", "secret%2ebin", "other/secret.bin", "m.glb", "out/m.glb", "in/m.bin")
ABSOLUTE = (
    "/etc/passwd",
    "/etc/hostname",
    "%2fetc%2fpasswd",
    "//etc/passwd",
    "/proc/self/environ",
    "/proc/self/mem",
    "/dev/zero",
    "/dev/stdin",
    "file:///etc/passwd",
    "FILE:/etc/passwd",
    "http://localhost:9/x.bin",
    "C:\\Windows\\win.ini",
    "C:/Windows/win.ini",
    "c|/x",
    "\\\\server\\share\\x",
    "//server/share/x",
    "\\\\?\\C:\\x",
    "~/x",
    "$HOME/x",
)
ENDINGS = (
    "",
    "",
    "",
    "#",
    "?",
    "#x",
    "?x=1",
    "%00",
    "%00.png",
    "\0",
    "/",
    "/.",
    "/..",
    "%",
    "%zz",
    ":",
    " ",
    "\n",
)
DATA = (
    "data:",
    "data:,",
    "data:;base64,",
    "data:;base64,AAAA",
    "data:;base64,A",
    "data:;base64,AA=A",
    "data:;base64,%41%41%41%41",
    "DATA:application/octet-stream;BASE64,AAAA",
    "data:application/gltf-buffer,%00%01%ff",
    "data:,\u20ac",
    "data:;base64,\u20ac",
)


def uri(random: Random) -> str:
    """Return a URI of the grammar."""
    kind = random.randrange(10)
    if kind == 0:
        return random.choice(DATA)
    if kind == 1:
        return random.choice(ABSOLUTE) + random.choice(ENDINGS)
    if kind == 2:
        return random.choice(PLAIN) + random.choice(ENDINGS)
    if kind == 3:
        return random.choice(
            ("long/" * 900, "a" * 300, "..", ".", "/", "", "\0", "\ud800", "\x1b[31mred", "%")
        )
    parts = [
        random.choice(UPWARDS if random.random() < 0.5 else INWARDS) for _ in range(random.randint(1, 6))
    ]
    parts.append(random.choice(SECRETS if random.random() < 0.7 else PLAIN))
    separator = "/" if random.random() < 0.9 else random.choice(("\\", "%2f", "//", "%5c"))
    return separator.join(parts) + random.choice(ENDINGS)


def surroundings(random: Random) -> tuple[dict[str, bytes], dict[str, str]]:
    """Return files and links that lie beside a hostile model: what its URIs may mean."""
    files = {"tex.png": b"\x89PNG\r\n", "sub/tex.png": b"\x89PNG\r\n", "x#/tex.png": b"\x89PNG\r\n"}
    links = {}
    if random.random() < 0.4:
        links["link"] = random.choice(("..", "../..", "/etc", "sub", "link", "../secret.bin", "gone"))
    if random.random() < 0.2:
        links["l.bin"] = random.choice(("../secret.bin", "/etc/hostname", "/dev/zero", "m.bin", "l.bin"))
    return files, links
