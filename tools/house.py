"""Numbers of the house: size, floors of the import graph, circles, and what the plan forbids.

    python tools/house.py [CHECKOUT] [--json]

Every figure is counted from the sources of the checkout, so that the state before a change and the state after it can
be put next to each other. Needs grimp, which import-linter brings.
"""

import argparse
import ast
import io
import json
import re
import shutil
import subprocess
import sys
import tempfile
import tokenize
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, get_args

ROOT = Path(__file__).resolve().parents[1]
# Identifiers that name a kind of part other than ridges. `print(...)` is none of them, the field `record.print` is;
# under inspect/cli a name that begins with print_ is a verb (print_table), elsewhere the kind (print_causes).
KIND_NAME = re.compile(
    r"wafer|Wafer|WAFER|Prints?(?=[A-Z]|$)|PRINTS?(?=_|$)|(?:^|_)prints?_|_prints?$|^prints$"
)
KIND_IN_TEXT = re.compile(r"wafer|print", re.IGNORECASE)
VERB_NAME = re.compile(r"^_?print(_(?!causes|recipe|expectation|record|model|prints|kind)|$)|_and_print$")
OF_LIBRARIES = {"print_svg"}  # matplotlib's
FRAGMENT_LINES = 120
MANY_PARAMETERS = 8
LARGEST_BYTES = 6_000_000
TABLES = {
    "anisoscope.bsdf.formats",
    "anisoscope.cli.line.line",
    "anisoscope.cli.study.papers",
    "anisoscope.profiles.files.load",
}  # modules that list plug-ins, each in a module of its own: writers, papers, protocols of a line with their libraries
KERNELS = re.compile(r"kernels$")
_LAYOUT = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENDMARKER,
}


def package_folders(checkout: Path) -> dict[str, Path]:
    """The folder of every package that pyproject lays somewhere of its own."""
    setuptools = _pyproject(checkout)["tool"]["setuptools"]
    return {package: checkout / folder for package, folder in setuptools["package-dir"].items()}


def source_files(checkout: Path) -> list[Path]:
    """All modules of the distribution."""
    return sorted(path for folder in package_folders(checkout).values() for path in folder.rglob("*.py"))


def import_graph(checkout: Path) -> dict[str, set[str]]:
    """Module -> modules that it imports, of the distribution alone."""
    import grimp  # noqa: PLC0415 - a heavy library, and only this function needs it

    folders = package_folders(checkout)
    with tempfile.TemporaryDirectory() as lain:
        for package, folder in folders.items():
            for path in folder.rglob("*.py"):
                target = Path(lain, *package.split("."), path.relative_to(folder))
                target.parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(path, target)
        # grimp takes the first root it finds: with this file the copy is a package before any installed one.
        Path(lain, "anisoscope", "__init__.py").touch()
        sys.path.insert(0, lain)
        imported = sys.modules.pop("anisoscope", None)  # or grimp would look where that one lies
        try:
            graph = grimp.build_graph("anisoscope", cache_dir=None)
        finally:
            sys.path.remove(lain)
            if imported is not None:
                sys.modules["anisoscope"] = imported
    return {
        module: {other for other in graph.find_modules_directly_imported_by(module) if other != "anisoscope"}
        for module in sorted(graph.modules)
        if module != "anisoscope"
    }


def packages_of(graph: Mapping[str, Iterable[str]], under: str = "anisoscope") -> dict[str, set[str]]:
    """The graph between the children of a package: child -> children that it imports."""
    found: dict[str, set[str]] = {}
    for module, imported in graph.items():
        child = _child(module, under)
        if child is None:
            continue
        others = {other for name in imported if (other := _child(name, under)) is not None}
        found.setdefault(child, set()).update(others - {child})
    return found


def _child(module: str, under: str) -> str | None:
    inside = module.removeprefix(f"{under}.")
    return inside.split(".")[0] if inside != module else None


def circles(graph: Mapping[str, set[str]]) -> list[list[str]]:
    """Sets of nodes that reach each other (strongly connected components of more than one node), largest first."""
    return sorted(
        (sorted(group) for group in _components(graph) if len(group) > 1), key=lambda group: -len(group)
    )


def floors(graph: Mapping[str, set[str]]) -> dict[str, int]:
    """Floor of every node, counted from the ground (1): one above the highest floor it imports.

    The nodes of a circle share one floor. The highest floor is the length of the longest chain of imports.
    """
    found: dict[str, int] = {}
    for group in _components(graph):  # what is imported comes before what imports it
        below = {other for node in group for other in graph[node]} - set(group)
        found.update(dict.fromkeys(group, 1 + max((found[other] for other in below), default=0)))
    return found


def _components(graph: Mapping[str, set[str]]) -> Iterator[list[str]]:
    """Tarjan's strongly connected components, in the order ground first (1972), without recursion."""
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    for root in graph:
        if root in index:
            continue
        index[root] = low[root] = len(index)
        stack.append(root)
        walk = [(root, iter(sorted(graph[root])))]
        while walk:
            node, rest = walk[-1]
            following = next(rest, None)
            if following is None:
                walk.pop()
                if walk:
                    low[walk[-1][0]] = min(low[walk[-1][0]], low[node])
                if low[node] == index[node]:
                    group = stack[stack.index(node) :]
                    del stack[-len(group) :]
                    low.update(
                        dict.fromkeys(group, sys.maxsize)
                    )  # done: no later node may count them as open
                    yield group
            elif following not in index:
                index[following] = low[following] = len(index)
                stack.append(following)
                walk.append((following, iter(sorted(graph[following]))))
            elif low[following] != sys.maxsize:
                low[node] = min(low[node], index[following])


def contract_layers(checkout: Path, container: str = "anisoscope") -> list[list[str]]:
    """Rows of the layers contract of a container, top first; each row names the packages on one floor."""
    for contract in _pyproject(checkout)["tool"]["importlinter"]["contracts"]:
        if contract["type"] == "layers" and contract.get("containers", ["anisoscope"]) == [container]:
            rows = [re.split(r"\s*[|:]\s*", row) for row in contract["layers"]]
            return [[name.strip("() ").removeprefix("anisoscope.") for name in row] for row in rows]
    return []


def upward_imports(graph: Mapping[str, Iterable[str]], layers: list[list[str]]) -> list[tuple[str, str]]:
    """Imports from a lower row of the layers to a higher one, or between two packages of one row."""
    height = {name: (-row, name) for row, names in enumerate(layers) for name in names}

    def place(module: str) -> tuple[int, str] | None:
        inside = module.removeprefix("anisoscope.")
        while inside and inside not in height:
            inside = inside.rpartition(".")[0]
        return height.get(inside)

    found = []
    for module, imported in graph.items():
        for other in sorted(imported):
            here, there = place(module), place(other)
            if here and there and (here[0] < there[0] or (here[0] == there[0] and here != there)):
                found.append((module, other))
    return found


def modules_with_one_importer(graph: Mapping[str, Iterable[str]]) -> dict[str, str]:
    """Module -> its only importer; packages do not count."""
    importers: dict[str, list[str]] = {}
    for module, imported in graph.items():
        for other in imported:
            importers.setdefault(other, []).append(module)
    packages = {_package(name) for name in graph}
    return {name: found[0] for name, found in importers.items() if len(found) == 1 and name not in packages}


def of_tables(single: Mapping[str, str]) -> list[str]:
    """Modules whose only importer is a table of plug-ins (`TABLES`): a module each is the point of the table."""
    return sorted(module for module, importer in single.items() if importer in TABLES)


def fragments(single: Mapping[str, str], graph: Iterable[str], lines: Mapping[str, int]) -> list[str]:
    """Modules that are part of their only importer rather than an idea of their own.

    A fragment has its only importer in its own package and fewer than `FRAGMENT_LINES` lines. A module whose only
    importer is in another package is a library of a lower floor that one command uses (a page of one report, a
    calibration of one procedure); a larger one is an idea of its own. Compiled kernels stay apart from what calls
    them, because importing them loads the compiler, and a plug-in stays apart from its table.
    """
    compiled = {name for name in graph if KERNELS.search(name)}
    return sorted(
        module
        for module, importer in single.items()
        if _package(module) == _package(importer)
        and lines[module] < FRAGMENT_LINES
        and module not in compiled
        and importer not in TABLES
    )


def module_lines(checkout: Path) -> dict[str, int]:
    """Module -> lines of its file."""
    return {
        _module(path, checkout): path.read_text(encoding="utf-8").count("\n")
        for path in source_files(checkout)
    }


def _package(module: str) -> str:
    return module.rpartition(".")[0]


def _module(path: Path, checkout: Path) -> str:
    """Dotted name of a source file."""
    folders = package_folders(checkout)
    package = max((name for name, folder in folders.items() if folder in path.parents), key=len)
    inside = path.relative_to(folders[package]).with_suffix("")
    return ".".join([package, *(part for part in inside.parts if part != "__init__")])


def code_lines(text: str) -> int:
    """Lines with code: neither blank nor only a comment nor part of a docstring."""
    lines: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in _LAYOUT:
            lines.update(range(token.start[0], token.end[0] + 1))
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            first = node.body[0] if node.body else None
            is_text = isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant)
            if is_text and isinstance(first.value.value, str):
                lines.difference_update(range(first.lineno, (first.end_lineno or first.lineno) + 1))
    return len(lines)


def kind_lines(text: str, *, verbs: bool = False) -> list[int]:
    """Lines with an identifier that names a kind (`KIND_NAME`); comments and strings do not count.

    Args:
        text: source of a module.
        verbs: whether `print_table` and the like print a table, as in the command line.
    """
    lines: set[int] = set()
    if not KIND_IN_TEXT.search(text):  # telling words apart takes long
        return []
    tokens = list(tokenize.generate_tokens(io.StringIO(text).readline))
    for before, token, after in zip(tokens, tokens[1:], tokens[2:], strict=False):
        if token.type != tokenize.NAME:
            continue
        name = token.string
        if name == "print":  # a field; `print(...)` and `console.print(...)` write
            found = before.string == "." and after.string != "("
        else:
            verb = name in OF_LIBRARIES or (verbs and VERB_NAME.search(name))
            found = bool(KIND_NAME.search(name)) and not verb
        if found:
            lines.add(token.start[0])
    return sorted(lines)


def float_arrays(text: str) -> int:
    """Declarations of a type named FloatArray."""
    count = 0
    if not re.search(r"^(?:type +)?FloatArray\b", text, re.MULTILINE):
        return count
    for node in ast.parse(text).body:
        targets: list[ast.expr] = []
        if isinstance(node, ast.Assign):
            targets = node.targets
        elif isinstance(node, ast.AnnAssign):
            targets = [node.target]
        elif "TypeAlias" in type(node).__name__:
            targets = [node.name]  # type: ignore[attr-defined]  # Python 3.12
        count += sum(isinstance(target, ast.Name) and target.id == "FloatArray" for target in targets)
    return count


def documentation(text: str) -> dict[str, int]:
    """Lines that hold only a comment, lines of docstrings, and docstrings of private functions and classes."""
    private, lines = 0, 0
    for node in ast.walk(ast.parse(text)):
        if not isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        if ast.get_docstring(node, clean=False) is None:
            continue
        lines += (node.body[0].end_lineno or node.body[0].lineno) - node.body[0].lineno + 1
        name = getattr(node, "name", "")
        private += name.startswith("_") and not name.endswith("__")
    comments = len(re.findall(r"^\s*#", text, re.MULTILINE))
    return {"comment_lines": comments, "docstring_lines": lines, "private_docstrings": private}


def long_signatures(text: str) -> int:
    """Functions and methods with more than `MANY_PARAMETERS` parameters; self and cls are none."""
    count = 0
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            named = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
            count += sum(one.arg not in {"self", "cls"} for one in named) > MANY_PARAMETERS
    return count


def public_names(checkout: Path) -> int:
    """Names of the public face."""
    face = package_folders(checkout)["anisoscope"] / "api.py"
    for node in ast.parse(face.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__":
            return len(ast.literal_eval(node.value))
    return 0


def options(checkout: Path) -> dict[str, int]:
    """Declarations behind the options and arguments of all commands: in the command line, and in models elsewhere.

    A declaration is counted once, however many commands have it. The commands are imported by a Python of their own,
    from the sources of the checkout; plug-ins are those of the installed distribution.
    """
    with tempfile.TemporaryDirectory() as lain:
        root = Path(lain, "anisoscope")
        root.mkdir()
        for package, folder in package_folders(checkout).items():
            inside = package.removeprefix("anisoscope").removeprefix(".")
            for entry in [folder] if inside else folder.iterdir():
                (root / (inside or entry.name)).symlink_to(entry)
        script = (
            f"import sys; sys.path[:0] = {[lain, str(ROOT / 'tools')]!r}; import house; house.write_options()"
        )
        counted = subprocess.run([sys.executable, "-c", script], stdout=subprocess.PIPE, check=True, cwd=lain)
    found: dict[str, int] = json.loads(counted.stdout)
    return found


def write_options() -> None:
    """Write the counts of `options` for the package that this Python imports."""
    import importlib  # noqa: PLC0415

    commands, found = declared_options(importlib.import_module("anisoscope.cli").app)
    by_hand = sum(module.startswith("anisoscope.cli") for module, _ in found)
    counts = {"commands": commands, "options_by_hand": by_hand, "options_of_models": len(found) - by_hand}
    sys.stdout.write(json.dumps(counts))


def declared_options(root: Any) -> tuple[int, set[tuple[str, str]]]:  # noqa: ANN401 - cyclopts is not needed here
    """Commands of an app, and module and name of every parameter and field that is one of their options."""
    commands, found, waiting = 0, set(), [root]
    while waiting:
        app = waiting.pop()
        waiting += [app[name] for name in app if not name.startswith("-")]
        if app.default_command is None:
            continue
        commands += 1
        owner = app.default_command
        for argument in app.assemble_argument_collection(parse_docstring=False):
            if not argument.keys and not argument.children:
                found.add(_shared_type(owner, argument.field_info.name))
            for child in argument.children:
                if not child.children:
                    found.add(_declared(argument.hint, child.keys[-1]))
    return commands, found


def _shared_type(owner: Any, name: str) -> tuple[str, str]:  # noqa: ANN401
    """Module and name of a parameter; an annotated type that several commands share is one declaration.

    What a library declares, such as a step of editing, goes with the annotation that is made of it.
    """
    hint = owner.__annotations__.get(name)
    if not hasattr(hint, "__metadata__"):
        return owner.__module__, f"{owner.__qualname__}.{name}"
    for one in hint.__metadata__:
        made_of = type(one).__module__
        if made_of.startswith("anisoscope.") and not made_of.startswith("anisoscope.cli"):
            return made_of, f"{name}: {one}"
    return ".".join(owner.__module__.split(".")[:2]), f"{name}: {get_args(hint)[:2]}"


def _declared(hint: object, field: str) -> tuple[str, str]:
    """Module and name of a field, in the class of a hint that declares it: bases may."""
    for kind in (hint, *get_args(hint)):
        for one in getattr(kind, "__mro__", ()):
            if field in vars(one).get("__annotations__", {}):
                return one.__module__, f"{one.__qualname__}.{field}"
    return "", field


def large_files(checkout: Path) -> int:
    """Tracked files over `LARGEST_BYTES`."""
    git = shutil.which("git") or "git"
    listed = subprocess.run(
        [git, "ls-files", "-z"], cwd=checkout, capture_output=True, text=True, check=True
    ).stdout.split("\0")
    paths = [checkout / path for path in listed if path]
    return sum(path.is_file() and path.stat().st_size > LARGEST_BYTES for path in paths)


def declarations(checkout: Path) -> dict[str, Any]:
    """What is declared, documented and kept in a checkout."""
    texts = {path: path.read_text(encoding="utf-8") for path in source_files(checkout)}
    cli = package_folders(checkout)["anisoscope"] / "cli"
    lines = sum(text.count("\n") for text in texts.values())
    words = [documentation(text) for text in texts.values()]
    comments, docstrings, private = (
        sum(one[key] for one in words) for key in ("comment_lines", "docstring_lines", "private_docstrings")
    )
    return {
        "cli_lines": sum(text.count("\n") for path, text in texts.items() if cli in path.parents),
        **options(checkout),
        "public_names": public_names(checkout),
        "long_signatures": sum(map(long_signatures, texts.values())),
        "comment_share": f"{comments / lines:.2%}",
        "docstring_share": f"{docstrings / lines:.1%}",
        "private_docstrings": private,
        "large_files": large_files(checkout),
    }


def sizes(checkout: Path) -> dict[str, Any]:
    """How much there is of a checkout."""
    texts = [path.read_text(encoding="utf-8") for path in source_files(checkout)]
    return {
        "files": len(texts),
        "lines": sum(text.count("\n") for text in texts),
        "code_lines": sum(map(code_lines, texts)),
    }


def numbers(checkout: Path, graph: Mapping[str, set[str]]) -> dict[str, Any]:
    """Figures of the imports of a checkout and of what its sources name; ``graph`` as of `import_graph`."""
    texts = {path: path.read_text(encoding="utf-8") for path in source_files(checkout)}
    inspect = package_folders(checkout)["anisoscope"]
    first = packages_of(graph)
    layers = contract_layers(checkout)
    contracts = _pyproject(checkout)["tool"]["importlinter"]["contracts"]
    lines = {
        path: kind_lines(text, verbs=inspect / "cli" in path.parents)
        for path, text in texts.items()
        if _shared(path.relative_to(checkout))
    }
    single = modules_with_one_importer(graph)
    first_circles, module_circles = circles(first), circles(graph)
    return {
        "first_level_packages": len(first),
        "first_level_floors": max(floors(first).values()),
        "first_level_arrows": sum(map(len, first.values())),
        "first_level_cycles": len(first_circles),
        "first_level_modules_in_cycles": sum(map(len, first_circles)),
        "module_floors": max(floors(graph).values()),
        "module_cycles": len(module_circles),
        "modules_in_cycles": sum(map(len, module_circles)),
        "layers_cover": f"{sum(name in first for row in layers for name in row)} of {len(first)}",
        "upward_imports": len(upward_imports(graph, layers)),
        "ignored_imports": sum(len(contract.get("ignore_imports", [])) for contract in contracts),
        "kind_lines": sum(map(len, lines.values())),
        "kind_files": sum(map(bool, lines.values())),
        "modules_with_one_importer": len(single),
        "modules_of_tables": len(of_tables(single)),
        "fragments": len(fragments(single, graph, module_lines(checkout))),
        "float_array_declarations": sum(float_arrays(text) for text in texts.values()),
        "root_modules": len(list(inspect.glob("*.py"))),
    }


MEANING = {
    "files": "modules",
    "lines": "lines",
    "code_lines": "lines of code (not blank, comment or docstring)",
    "first_level_packages": "packages and modules of the first level",
    "first_level_floors": "floors of the first level (longest chain of imports; a cycle counts as one)",
    "first_level_arrows": "pairs of the first level of which one imports the other",
    "first_level_cycles": "cycles of the first level",
    "first_level_modules_in_cycles": "of the first level, in a cycle",
    "module_floors": "floors of all modules",
    "module_cycles": "cycles of modules",
    "modules_in_cycles": "modules in a cycle",
    "layers_cover": "of the first level, named by the layers contract",
    "upward_imports": "imports that go up or across in the layers contract",
    "ignored_imports": "imports that a contract ignores",
    "kind_lines": "lines of inspect/ outside its kinds with an identifier that names a kind (print, wafer)",
    "kind_files": "files with such a line",
    "modules_with_one_importer": "modules with exactly one importer",
    "modules_of_tables": "of these plug-ins of a table, such as a reader of one file format",
    "fragments": "of the others small, not compiled, and in the package of their importer",
    "float_array_declarations": "declarations of FloatArray",
    "root_modules": "modules in the root of inspect/",
    "cli_lines": "lines of inspect/cli",
    "commands": "commands",
    "options_by_hand": "declarations of options and arguments in inspect/cli",
    "options_of_models": "declarations of options in models elsewhere",
    "public_names": "names of anisoscope.api",
    "long_signatures": f"functions with more than {MANY_PARAMETERS} parameters",
    "comment_share": "of all lines, only a comment",
    "docstring_share": "of all lines, docstring",
    "private_docstrings": "docstrings of private functions and classes",
    "large_files": f"tracked files over {LARGEST_BYTES / 1e6:.0f} MB",
}


def _shared(path: Path) -> bool:
    """Whether a file of inspect/ should know no kind; before there were kinds, prints had a folder of their own."""
    return path.parts[0] == "inspect" and path.parts[1] not in {"kinds", "prints"}


def _pyproject(checkout: Path) -> dict[str, Any]:
    return tomllib.loads((checkout / "pyproject.toml").read_text(encoding="utf-8"))


def main() -> None:
    """Print the figures of a checkout, by default this one."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("checkout", nargs="?", type=Path, default=ROOT)
    parser.add_argument("--json", action="store_true")
    chosen = parser.parse_args()
    checkout = chosen.checkout.resolve()
    found = sizes(checkout) | numbers(checkout, import_graph(checkout)) | declarations(checkout)
    if chosen.json:
        sys.stdout.write(json.dumps(found, indent=2) + "\n")
        return
    sys.stdout.writelines(f"{value!s:>10}  {MEANING[name]}\n" for name, value in found.items())


if __name__ == "__main__":
    main()
