"""Join the modules of an engine's package to one module, for users without npm.

``engines/NAME`` holds the hand-written JavaScript. Only its ``shaders.js`` is generated. The modules keep to
a few forms, so that no parser is needed: each imports by name, and exports where it declares. Only
``index.js`` hands on names of other modules. No two modules declare the same name.
"""

from __future__ import annotations

import re
from pathlib import Path

PACKAGE = Path(__file__).parents[1]
IMPORT = re.compile(r"^import \{([^}]*)\} from '([^']+)';\n", re.MULTILINE)
OWN = re.compile(r"^((?:import|export) \{[^}]*\}) from '\./([^']+)';\n", re.MULTILINE)
WIDTH = 110
COMMENT = re.compile(r"(?://.*\n)+")


def engines_folder() -> Path:
    """Return the folder that holds one folder for each engine.

    A wheel has it in the package. An editable install has it where the repository has it.
    """
    carried = PACKAGE / "engines"
    return carried if carried.is_dir() else PACKAGE.parents[1] / "engines"


def single_module(engine: str, shaders: str) -> str:
    """Return ``index.js`` of an engine and the modules that it imports as one; ``shaders`` is ``shaders.js``.

    It begins with the first comments of both: what the module is for, and the command that wrote it.
    """
    folder = engines_folder() / engine
    bodies: dict[str, str] = {}
    foreign: dict[str, set[str]] = {}
    comments: dict[str, str] = {}

    def add(name: str) -> None:
        text = shaders if name == "shaders.js" else (folder / name).read_text(encoding="ascii")
        for _, source in OWN.findall(text):
            if source not in bodies:
                add(source)
        text = OWN.sub(lambda found: f"{found[1]};\n" if found[1].startswith("export") else "", text)
        for names, source in IMPORT.findall(text):
            foreign.setdefault(source, set()).update(word for word in re.split(r"[\s,]+", names) if word)
        text = IMPORT.sub("", text)
        if name in ("index.js", "shaders.js"):
            comment = COMMENT.match(text)
            comments[name] = comment[0] if comment else ""
            text = text.removeprefix(comments[name])
        # The names of index.js are the package's own. All others stay in the module.
        bodies[name] = (
            text if name == "index.js" else re.sub("^export ", "", text, flags=re.MULTILINE)
        ).strip()

    add("index.js")
    imports = []
    for source, names in sorted(foreign.items()):
        ordered = sorted(names, key=str.lower)
        line = f"import {{ {', '.join(ordered)} }} from '{source}';"
        if len(line) > WIDTH:
            lines = ",\n    ".join(ordered)
            line = f"import {{\n    {lines},\n}} from '{source}';"
        imports.append(line)
    head = f"{comments['index.js']}//\n{comments['shaders.js']}"
    return "\n\n".join([head + "\n" + "\n".join(imports), *bodies.values()]) + "\n"
