#!/usr/bin/env python3
"""Move and merge modules after a mapping, and rewrite everything that names them. Standard library only.

    python fold.py ROOT MAPPING check  [STAGE ...]     cycles, collisions, modules without a place; writes nothing
    python fold.py ROOT MAPPING apply  [STAGE ...]     does it in ROOT's working tree (then run ruff; see run.sh)
    python fold.py ROOT MAPPING page   [STAGE ...]     "what moved where" as Markdown, to standard output

MAPPING, one directive a line; names are relative to haptorb unless they begin with haptorb:

    == STAGE                            begins a stage
    NEW <- OLD OLD OLD*                 modules that become one; the first gives the docstring, the order is kept as far
                                        as definitions before use permit; NEW ending in "/" moves each with its own name
    sym OLD:Name,Name -> NEW            single definitions that go elsewhere
    rename OLD:Name NewName             a name in its new file
    package NEW text of the docstring
    rule OLD. -> NEW.                   modules of that package which nothing names (added since)
    folder old/path -> new/path         data files, tests (relative to ROOT)
    patch FILE-AFTER|||regex|||replacement
"""
from __future__ import annotations

import ast
import bisect
import builtins
import collections
import fnmatch
import re
import subprocess
import sys
import textwrap
from dataclasses import dataclass, field
from pathlib import Path

BUILTINS = set(dir(builtins))


def fail(text):
    print("ERROR", text)
    FAULTS.append(text)


FAULTS: list[str] = []
SHADOWED: set[str] = set()  # "package.name" where the package's own name hides a module of that name


# ------------------------------------------------------------------ reading modules
class Text:
    """Source with byte-column positions made to character offsets."""

    def __init__(self, src):
        self.src = src
        self.lines = src.splitlines(keepends=True)
        self.starts = [0]
        for line in self.lines:
            self.starts.append(self.starts[-1] + len(line))

    def at(self, line, col):
        text = self.lines[line - 1] if line <= len(self.lines) else ""
        if text.isascii():
            return self.starts[line - 1] + col
        return self.starts[line - 1] + len(text.encode()[:col].decode())

    def span(self, node):
        return self.at(node.lineno, node.col_offset), self.at(node.end_lineno, node.end_col_offset)


@dataclass
class Stmt:
    mod: "Mod"
    node: ast.AST
    start: int
    end: int
    defs: set
    main: bool = False
    tc: bool = False
    index: int = 0


@dataclass
class Binding:
    kind: str  # def, from, mod, ext
    source: str = ""
    attr: str = ""
    tc: bool = False
    comment: str = ""
    stmt: Stmt | None = None


def bound_in_target(node):
    return {n.id for n in ast.walk(node) if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)}


class Mod:
    def __init__(self, name, path, root):
        self.name, self.path = name, path
        self.is_pkg = path.name == "__init__.py"
        self.text = Text(path.read_text(encoding="utf-8"))
        self.tree = ast.parse(self.text.src)
        self.doc = ast.get_docstring(self.tree, clean=True) or ""
        self.future = False
        self.all = None
        self.stmts = []
        self.bind = {}
        self.header = ""

    def read(self, modules):
        src, T = self.text.src, self.text
        prev = 0
        body = self.tree.body
        for i, node in enumerate(body):
            first = node.lineno
            if getattr(node, "decorator_list", None):
                first = min(first, min(d.lineno for d in node.decorator_list))
            start_line = T.starts[first - 1]
            end = T.starts[node.end_lineno]  # through the end of the line
            lead = src[prev:start_line]
            start = start_line - len(lead.lstrip("\n")) if lead.strip() else start_line
            if i == 0 and isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
                prev = end
                continue
            if isinstance(node, ast.ImportFrom) and node.module == "__future__":
                self.future, prev = True, end
                continue
            if isinstance(node, (ast.Import, ast.ImportFrom)):
                if lead.strip():
                    self.header += lead.strip("\n") + "\n"
                self._imports(node, modules, False)
                prev = end
                continue
            if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING" and not node.orelse:
                rest = [b for b in node.body if not isinstance(b, (ast.Import, ast.ImportFrom))]
                if rest:
                    fail(f"{self.name}: statements under TYPE_CHECKING")
                if lead.strip():
                    self.header += lead.strip("\n") + "\n"
                for b in node.body:
                    self._imports(b, modules, True)
                prev = end
                continue
            if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__":
                self.all = list(ast.literal_eval(node.value))
                prev = end
                continue
            defs = set()
            if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)):
                defs.add(node.name)
            elif isinstance(node, ast.Assign):
                for t in node.targets:
                    defs |= bound_in_target(t)
            elif isinstance(node, (ast.AnnAssign, ast.AugAssign)):
                defs |= bound_in_target(node.target)
            elif isinstance(node, (ast.If, ast.Try, ast.For, ast.With)):
                for n in ast.walk(node):
                    if isinstance(n, (ast.FunctionDef, ast.ClassDef)):
                        defs.add(n.name)
                main = isinstance(node, ast.If) and "__name__" in ast.unparse(node.test)
                if not main:
                    defs |= bound_in_target(node)
            s = Stmt(self, node, start, end, defs, index=len(self.stmts))
            s.main = isinstance(node, ast.If) and "__name__" in ast.unparse(node.test)
            self.stmts.append(s)
            for d in defs:
                if d in self.bind and self.bind[d].kind == "def":
                    continue
                self.bind[d] = Binding("def", stmt=s)
            prev = end
        tail = src[prev:]
        if tail.strip() and self.stmts:
            self.stmts[-1].end = len(src)
        self.used = None

    def _imports(self, node, modules, tc):
        T = self.text
        for alias in node.names:
            line = T.lines[alias.lineno - 1]
            last = T.lines[node.end_lineno - 1]
            comment = ""
            for one in (line, last) if alias.lineno != node.end_lineno else (line,):
                if "#" in one:
                    comment = one[one.index("#"):].strip()
                    if one is last and len(node.names) > 1 and alias.lineno != node.end_lineno:
                        comment = comment if "ignore" in comment or "noqa" in comment else ""
                    break
            local = alias.asname or (alias.name if isinstance(node, ast.ImportFrom) else alias.name.split(".")[0])
            if isinstance(node, ast.ImportFrom):
                if node.level:
                    fail(f"{self.name}: relative import")
                full = f"{node.module}.{alias.name}"
                if full in modules and full not in SHADOWED:
                    b = Binding("mod", full, "", tc, comment)
                elif node.module in modules:
                    b = Binding("from", node.module, alias.name, tc, comment)
                else:
                    b = Binding("ext", node.module, alias.name, tc, comment)
            elif alias.name in modules:
                if not alias.asname:
                    fail(f"{self.name}: plain import of {alias.name}")
                b = Binding("mod", alias.name, "", tc, comment)
            else:
                b = Binding("ext", alias.name if alias.asname else alias.name, "", tc, comment)
            if local in self.bind and not self.bind[local].tc:
                continue
            self.bind[local] = b


# ------------------------------------------------------------------ scopes
def arg_names(a):
    out = [x.arg for x in a.posonlyargs + a.args + a.kwonlyargs]
    return out + [x.arg for x in (a.vararg, a.kwarg) if x]


def local_bindings(body):
    """Names bound in a function's or class's body, nested scopes left out; (names, globals)."""
    names, globs, nonl = {}, set(), set()

    def add(n, node):
        names.setdefault(n, node)

    def walk(node, top=False):
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)):
            add(node.name, node)
            for d in node.decorator_list:
                walk(d)
            return
        if isinstance(node, ast.Lambda):
            return
        if isinstance(node, (ast.ListComp, ast.SetComp, ast.GeneratorExp, ast.DictComp)):
            for n in ast.walk(node):
                if isinstance(n, ast.NamedExpr):
                    add(n.target.id, n)
            return
        if isinstance(node, ast.Name) and isinstance(node.ctx, (ast.Store, ast.Del)):
            add(node.id, node)
        elif isinstance(node, (ast.Import, ast.ImportFrom)):
            for a in node.names:
                add(a.asname or a.name.split(".")[0], node)
        elif isinstance(node, ast.ExceptHandler) and node.name:
            add(node.name, node)
        elif isinstance(node, (ast.MatchAs, ast.MatchStar)) and node.name:
            add(node.name, node)
        elif isinstance(node, ast.MatchMapping) and node.rest:
            add(node.rest, node)
        elif isinstance(node, ast.Global):
            globs.update(node.names)
        elif isinstance(node, ast.Nonlocal):
            nonl.update(node.names)
        for c in ast.iter_child_nodes(node):
            walk(c)

    for n in body:
        walk(n)
    for g in globs | nonl:
        names.pop(g, None)
    return names, globs


class Scopes(ast.NodeVisitor):
    """Finds every use of a global name; self.found: list of (name, node, kind, frozenset of names bound around it)."""

    def __init__(self):
        self.stack = []  # (kind, names)
        self.found = []
        self.lazy = []  # (import node, function scope body owner)
        self.fstring = None
        self.deferred = 0

    def visible(self):
        out = set()
        for k, names in self.stack:
            if k != "class":
                out |= set(names)
        return out

    def resolve(self, name, node):
        for i in range(len(self.stack) - 1, -1, -1):
            kind, names = self.stack[i]
            if name in self.stack_globs[i]:
                return "global"
            if kind == "class":
                if i != len(self.stack) - 1:
                    continue
                if name in names:
                    b = names[name]
                    if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load):
                        if (node.lineno, node.col_offset) < (b.end_lineno, b.end_col_offset) and not (
                            isinstance(b, ast.Name) and (b.lineno, b.col_offset) < (node.lineno, node.col_offset) and False
                        ):
                            # used before or within the statement that binds it
                            return "global"
                        # `x: T = f(x)` : the value is evaluated before
                        return "maybe"
                    return "local"
                continue
            if name in names:
                return "local"
        return "global"

    stack_globs: list = []

    def push(self, kind, names, globs=frozenset()):
        self.stack.append((kind, names))
        self.stack_globs = [*self.stack_globs, globs]

    def pop(self):
        self.stack.pop()
        self.stack_globs = self.stack_globs[:-1]

    def note(self, name, node, kind="name"):
        r = self.resolve(name, node)
        if r != "local":
            self.found.append((name, node, kind if r == "global" else kind + "?", self.visible(), self.fstring, self.deferred))

    def visit_Name(self, node):
        self.note(node.id, node)

    def visit_JoinedStr(self, node):
        before, self.fstring = self.fstring, self.fstring or node
        self.generic_visit(node)
        self.fstring = before

    def visit_Global(self, node):
        for n in node.names:
            self.found.append((n, node, "global", self.visible(), None, self.deferred))

    def strings(self, node):
        if node is None:
            return
        for c in ast.walk(node):
            if isinstance(c, ast.Constant) and isinstance(c.value, str) and re.fullmatch(r"[\w.\[\], |]+", c.value):
                try:
                    inner = ast.parse(c.value, mode="eval")
                except SyntaxError:
                    continue
                for n in ast.walk(inner):
                    if isinstance(n, ast.Name):
                        self.found.append((n.id, c, "string", self.visible(), None, 1))

    def annotation(self, node):
        if node is not None:
            self.deferred += 1
            self.visit(node)
            self.deferred -= 1
            if not (isinstance(node, ast.Subscript) and ast.unparse(node.value) in ("Annotated", "Literal")):
                if "Literal" not in ast.unparse(node) and "Annotated" not in ast.unparse(node):
                    self.strings(node)

    def visit_Call(self, node):
        f = ast.unparse(node.func)
        if f == "cast" and node.args:
            self.strings(node.args[0]) if isinstance(node.args[0], ast.Constant) else None
        if f == "TypeVar":
            for k in node.keywords:
                if isinstance(k.value, ast.Constant):
                    self.strings(k.value)
        self.generic_visit(node)

    def visit_FunctionDef(self, node):
        if self.stack:
            pass
        for d in node.decorator_list:
            self.visit(d)
        for d in node.args.defaults + [x for x in node.args.kw_defaults if x]:
            self.visit(d)
        for a in node.args.posonlyargs + node.args.args + node.args.kwonlyargs + [x for x in (node.args.vararg, node.args.kwarg) if x]:
            self.annotation(a.annotation)
        self.annotation(node.returns)
        names, globs = local_bindings(node.body)
        for a in arg_names(node.args):
            names.setdefault(a, node)
        self.push("function", names, globs)
        self.deferred += 1
        for b in node.body:
            self.visit(b)
        self.deferred -= 1
        self.pop()

    visit_AsyncFunctionDef = visit_FunctionDef

    def visit_Lambda(self, node):
        for d in node.args.defaults + [x for x in node.args.kw_defaults if x]:
            self.visit(d)
        self.push("function", {a: node for a in arg_names(node.args)})
        self.deferred += 1
        self.visit(node.body)
        self.deferred -= 1
        self.pop()

    def visit_ClassDef(self, node):
        for d in node.decorator_list:
            self.visit(d)
        for b in node.bases:
            self.visit(b)
        for k in node.keywords:
            self.visit(k.value)
        names, globs = local_bindings(node.body)
        self.push("class", names, globs)
        for b in node.body:
            self.visit(b)
        self.pop()

    def visit_AnnAssign(self, node):
        self.visit(node.target)
        self.annotation(node.annotation)
        # pydantic and dataclasses look at annotations of a class at once
        if node.value:
            self.visit(node.value)

    def comprehension(self, node):
        names = {}
        for g in node.generators:
            for n in bound_in_target(g.target):
                names[n] = node
        self.visit(node.generators[0].iter)
        self.push("function", names)
        for i, g in enumerate(node.generators):
            self.visit(g.target)
            if i:
                self.visit(g.iter)
            for c in g.ifs:
                self.visit(c)
        if isinstance(node, ast.DictComp):
            self.visit(node.key)
            self.visit(node.value)
        else:
            self.visit(node.elt)
        self.pop()

    visit_ListComp = visit_SetComp = visit_GeneratorExp = visit_DictComp = comprehension

    def visit_Import(self, node):
        if self.stack:
            self.lazy.append((node, self.visible()))

    visit_ImportFrom = visit_Import


# ------------------------------------------------------------------ mapping
class Mapping:
    def __init__(self, path, modules, stages):
        self.target, self.order, self.docfrom = {}, collections.defaultdict(list), {}
        self.syms, self.renames, self.packages, self.rules, self.folders, self.patches = {}, {}, {}, [], [], []
        self.doctext = {}
        self.drops, self.aliases, self.texts, self.by_pattern = set(), {}, {}, set()
        self.stage_of = {}
        stage, active = "", not stages
        self.all_stages = []
        full = lambda n: n if n.split(".")[0].startswith("haptorb") else f"haptorb.{n}" if n else "haptorb"
        for number, line in enumerate(Path(path).read_text().splitlines(), 1):
            line = line.strip()
            if not line or line.startswith("#"):
                continue
            if line.startswith("== "):
                stage = line[3:].strip()
                self.all_stages.append(stage)
                active = not stages or stage in stages
                continue
            if not active:
                continue
            word, _, rest = line.partition(" ")
            if word == "sym":
                old, new = (x.strip() for x in rest.split("->"))
                m, names = old.split(":")
                for n in names.split(","):
                    self.syms[full(m), n] = full(new)
            elif word == "rename":
                old, new = rest.split()
                m, n = old.split(":")
                self.renames[full(m), n] = new
            elif word == "package":
                new, _, text = rest.partition(" ")
                self.packages[full(new)] = text
            elif word == "doc":
                new, _, text = rest.partition(" ")
                self.doctext[full(new)] = text
            elif word == "rule":
                old, new = (x.strip() for x in rest.split("->"))
                self.rules.append((full(old), full(new)))
            elif word == "folder":
                old, new = (x.strip() for x in rest.split("->"))
                self.folders.append((old, new))
            elif word == "alias":
                new, name, other = rest.split()
                self.aliases[full(new), name] = other
            elif word == "text":
                old, new = rest.split()
                self.texts[full(old)] = full(new)
            elif word == "drop":
                self.drops |= {full(n) for n in rest.split()}
            elif word == "patch":
                self.patches.append(tuple(x for x in rest.split("|||")))
            elif "<-" in line:
                new, olds = (x.strip() for x in line.split("<-"))
                for old in olds.split():
                    pattern = full(old)
                    hits = [m for m in modules if fnmatch.fnmatchcase(m, pattern) and pattern.count(".") == m.count(".")] if "*" in pattern else [pattern]
                    if "*" in pattern:
                        hits = sorted(h for h in hits if h not in self.target and not modules[h].is_pkg)
                    if "*" in pattern:
                        self.by_pattern.update(hits)
                    for h in hits:
                        if h not in modules:
                            print(f"note {path}:{number}: {h} is not there")
                            continue
                        t = full(new) if not new.endswith("/") else full(new[:-1]) + "." + h.rpartition(".")[2]
                        if h in self.target:
                            fail(f"line {number}: {h} has a place already: {self.target[h]}")
                        self.target[h] = t
                        self.stage_of[h] = stage
                        self.order[t].append(h)
            else:
                fail(f"line {number}: not understood: {line}")


# ------------------------------------------------------------------ the work
class Fold:
    def __init__(self, root, mapping, stages):
        self.root = Path(root)
        self.src = self.root / "src"
        self.modules = {}
        for top in sorted(p for p in self.src.iterdir() if (p / "__init__.py").is_file()):
            for path in sorted(top.rglob("*.py")):
                name = ".".join(path.relative_to(self.src).with_suffix("").parts)
                name = name.removesuffix(".__init__")
                self.modules[name] = Mod(name, path, root)
        SHADOWED.clear()
        for m, mod in self.modules.items():
            if mod.is_pkg:
                for node in mod.tree.body:
                    if isinstance(node, ast.ImportFrom):
                        SHADOWED.update(f"{m}.{a.asname or a.name}" for a in node.names if f"{node.module}.{a.name}" not in self.modules or f"{node.module}.{a.name}" in SHADOWED)
                    elif isinstance(node, (ast.FunctionDef, ast.ClassDef)):
                        SHADOWED.add(f"{m}.{node.name}")
        for m in self.modules.values():
            m.read(self.modules)
        self.map = Mapping(mapping, self.modules, stages)
        self.target = {}
        self.unmapped = []
        for m, mod in self.modules.items():
            t = self.map.target.get(m)
            if t is None:
                for old, new in self.map.rules:
                    if m.startswith(old) and not mod.is_pkg:
                        t = new if not new.endswith(".") else new + m[len(old):]
                        self.unmapped.append((m, t))
                        self.map.order[t].append(m)
                        break
            self.target[m] = t or m
        # a package's __init__ that has only a docstring goes with its package
        self.dropped = set()
        self.target_is_pkg = {}
        olds_in_use = {self.target[m] for m, mod in self.modules.items() if not mod.is_pkg}
        for m, mod in self.modules.items():
            if mod.is_pkg and m not in self.map.target:
                alive = any(t.startswith(m + ".") for t in olds_in_use)
                clash = m in olds_in_use
                if not alive or clash:
                    self.dropped.add(m)
                    if m in self.map.drops:
                        continue
                    if mod.stmts and not all(isinstance(s.node, ast.Expr) for s in mod.stmts):
                        fail(f"package {m} disappears, but its __init__ has code")
                    elif any(b.kind != "ext" for b in mod.bind.values()) and mod.all is None:
                        fail(f"package {m} disappears, but its __init__ imports")
        for m in self.dropped:
            if m in self.map.texts:
                self.target[m] = self.map.texts[m]
        for m, mod in self.modules.items():
            self.uses(mod)
        self.syms_target = {}
        self.build()
        # what a rule or a pattern placed, and what closes a circle there, becomes a file of its own beside it
        for _ in range(12):
            bad = self.circles()
            loose = {m for m, _ in self.unmapped} | self.map.by_pattern
            moved = [m for m in loose for c in bad if self.target[m] in c and len(self.groups[self.target[m]]) > 1]
            if not moved:
                break
            moved.sort(key=lambda m: (m in self.map.by_pattern, m))
            for m in moved[:1]:
                t = self.target[m]
                self.map.order[t].remove(m)
                own = f"{t.rpartition('.')[0]}.{m.rpartition('.')[2]}"
                print(f"note: {m} would close a circle in {t}; it becomes {own}")
                self.target[m] = own
                self.map.order[own].append(m)
            self.build()

    def uses(self, mod):
        for s in mod.stmts:
            sc = Scopes()
            sc.visit(s.node)
            s.found, s.lazy = sc.found, sc.lazy

    def sym_target(self, m, name):
        return self.map.syms.get((m, name)) or self.target[m]

    def stmt_target(self, s):
        for d in s.defs:
            if (s.mod.name, d) in self.map.syms:
                return self.map.syms[s.mod.name, d]
        return self.target[s.mod.name]

    def entity(self, m, name, seen=()):
        """What `name` in module `m` is."""
        mod = self.modules[m]
        b = mod.bind.get(name)
        if b is None:
            if f"{m}.{name}" in self.modules:
                return ("mod", f"{m}.{name}")
            return ("sym", m, name)  # by __getattr__, or unknown
        if b.kind == "def":
            return ("sym", m, name)
        if b.kind == "mod":
            return ("mod", b.source)
        if b.kind == "ext":
            return ("ext", b.source, b.attr, name if not b.attr else "")
        return self.imported(b.source, b.attr)

    def imported(self, source, attr):
        src = self.modules[source]
        if src.is_pkg and source not in self.dropped and attr in src.bind and src.bind[attr].kind != "def":
            if self.target[source] == source or source in self.map.target:
                if self.target_pkg(self.target[source]):
                    return ("sym", source, attr)  # a public name stays public
        return self.entity(source, attr)

    def target_pkg(self, t):
        return t in self.pkg_targets

    # -- building
    def build(self):
        every = {self.target[m] for m in self.modules if m not in self.dropped}
        self.pkg_targets = {
            self.target[m] for m, mod in self.modules.items()
            if mod.is_pkg and m not in self.dropped and any(t.startswith(self.target[m] + ".") for t in every)
        }
        # groups: target → list of (module, [stmts])
        groups = collections.defaultdict(lambda: collections.OrderedDict())
        for t, olds in self.map.order.items():
            for o in olds:
                groups[t].setdefault(o, [])
        for m, mod in self.modules.items():
            if m in self.dropped:
                continue
            groups[self.target[m]].setdefault(m, [])
            for s in mod.stmts:
                groups[self.stmt_target(s)].setdefault(m, []).append(s)
        self.groups = groups
        self.forced = dict(self.map.renames)  # (m, name) → new name
        for _ in range(12):
            before = dict(self.forced)
            self.assign_names()
            if self.forced == before:
                break
        else:
            fail("names do not settle")
        self.edges_and_order()

    def newname(self, m, name):
        return self.forced.get((m, name), name)

    def prefix(self, m, name):
        leaf = m.rpartition(".")[2].strip("_")
        if name.isupper() or re.fullmatch(r"_?[A-Z][A-Z0-9_]*", name):
            if leaf.upper() in name:
                leaf = "_".join(m.split(".")[-2:])
            out = leaf.upper() + "_" + name.lstrip("_")
        elif re.fullmatch(r"_?[A-Z]\w*", name):
            out = "".join(w.capitalize() for w in leaf.split("_")) + name.lstrip("_")
        else:
            out = leaf + "_" + name.lstrip("_")
        return "_" + out if name.startswith("_") else out

    def same_typevar(self, a, b):
        na, nb = a.node, b.node
        return ast.dump(na) == ast.dump(nb) and isinstance(na, ast.Assign) and isinstance(na.value, ast.Call) and ast.unparse(na.value.func) in ("TypeVar", "ParamSpec")

    def same_definition(self, one, other):
        """Whether two private definitions are word for word the same, and mean the same."""
        (m, _), a = one
        (m2, _), b = other
        if ast.dump(a.node) != ast.dump(b.node):
            return False
        if isinstance(a.node, ast.Assign):
            return isinstance(a.node.value, ast.Constant) and isinstance(a.node.value.value, str)
        if not isinstance(a.node, ast.FunctionDef):
            return False
        for f in a.found:
            x, y = self.modules[m].bind.get(f[0]), self.modules[m2].bind.get(f[0])
            if (x is None) != (y is None):
                return False
            if x is not None and f[0] != a.node.name and self.entity(m, f[0]) != self.entity(m2, f[0]):
                return False
        return not a.lazy

    def assign_names(self):
        """Collisions of definitions; then the local name of every imported thing in each target."""
        self.skip = set()
        self.locals = {}  # (target, entity) → local name
        self.need_runtime = collections.defaultdict(dict)  # target → entity → tc?
        for t, members in self.groups.items():
            if len(members) < 2 and t in members and not any(k[0] == t for k in self.forced):
                single = True
            else:
                single = False
            owners = collections.defaultdict(list)
            for m, stmts in members.items():
                for s in stmts:
                    for d in s.defs:
                        owners[self.newname(m, d)].append((m, d, s))
            for n, who in owners.items():
                mods = {m for m, _, _ in who}
                if len(mods) > 1:
                    whos = list({(m, d): s for m, d, s in who}.items())
                    if n.startswith("_") and all(self.same_definition(whos[0], one) for one in whos[1:]) or all(
                        self.same_typevar(whos[0][1], s) for _, s in whos[1:]
                    ):
                        for (_, _), s in whos[1:]:
                            self.skip.add(id(s))
                        continue
                    if n in ("__getattr__", "__dir__"):
                        fail(f"{t}: two {n}")
                        continue
                    keep = None
                    if not n.startswith("_"):
                        # the member after which the file is named keeps a public name
                        firsts = [m for m, _ in (k for k, _ in whos) if m.rpartition(".")[2] == t.rpartition(".")[2]]
                        keep = firsts[0] if firsts else whos[0][0][0]
                    for (m, d), _ in whos:
                        if m != keep and (m, d) not in self.map.renames:
                            self.forced[m, d] = self.prefix(m, d)
            defined = {self.newname(m, d) for m, stmts in members.items() for s in stmts for d in s.defs}
            # entities needed
            wanted = collections.OrderedDict()  # entity → Counter of local names
            tcs = {}
            around = collections.defaultdict(set)
            for m, stmts in members.items():
                mod = self.modules[m]
                for s in stmts:
                    for name, node, kind, visible, fs, deferred in s.found:
                        b = mod.bind.get(name)
                        if b is None:
                            if name in BUILTINS and name in defined and kind != "name?":
                                # a definition of another member would hide the builtin
                                for mm, ss in members.items():
                                    for s2 in ss:
                                        for d in s2.defs:
                                            if self.newname(mm, d) == name and mm != m:
                                                self.forced[mm, d] = self.prefix(mm, d)
                            continue
                        e = self.entity(m, name)
                        if e[0] == "sym" and self.sym_target(e[1], e[2]) == t and e[2] in self.modules[e[1]].bind:
                            # local in the new file; does something hide the name it gets?
                            new = self.newname(e[1], e[2])
                            if new != name and new in visible:
                                self.forced[e[1], e[2]] = self.prefix(e[1], e[2])
                            continue
                        if e[0] == "mod" and self.target[e[1]] == t:
                            continue
                        wanted.setdefault(e, collections.Counter())[name] += 1
                        if e[0] == "mod":
                            around[e] |= visible
                        tc = b.tc or kind == "string"
                        tcs[e] = tcs.get(e, True) and (b.tc if b.kind != "def" else False)
                # imports that nothing in the module uses: re-exports and effects
                used = {f[0] for s in mod.stmts for f in s.found}
                if m in self.target and self.target[m] == t:
                    for name, b in mod.bind.items():
                        if b.kind == "def" or name in used:
                            continue
                        if mod.is_pkg or "noqa" in b.comment or (mod.all and name in mod.all) or (b.kind == "from" and b.attr == name and self.reexported(m, name)):
                            e = self.entity(m, name)
                            if e[0] == "sym" and self.sym_target(e[1], e[2]) == t:
                                continue
                            wanted.setdefault(e, collections.Counter())[name] += 1
                            tcs[e] = tcs.get(e, True) and b.tc
            taken = {n: None for n in defined}
            modnames = {}
            every_local = {n for e, names in wanted.items() for n in names if e[0] != "mod"}
            for e, names in wanted.items():
                choice = names.most_common(1)[0][0]
                choice = self.map.aliases.get((t, choice), choice)
                if e[0] == "mod" and self.target[e[1]] != e[1]:
                    to = self.target[e[1]]
                    leaf = to.rpartition(".")[2]
                    if choice == e[1].rpartition(".")[2] and leaf not in around[e] and leaf not in taken and leaf not in every_local:
                        choice = leaf
                    if to in modnames and modnames[to] not in around[e]:
                        self.locals[t, e] = modnames[to]
                        continue
                    modnames[to] = choice
                if choice in taken and taken[choice] != e:
                    base = choice
                    if e[0] == "sym":
                        choice = f"{e[1].rpartition('.')[2]}_{base.lstrip('_')}"
                        if base.startswith("_"):
                            choice = "_" + choice
                        if base[0].isupper() and not base.isupper():
                            choice = base + e[1].rpartition(".")[2].title().replace("_", "")
                    elif e[0] == "mod":
                        choice = f"{e[1].split('.')[-2]}_{base}"
                    else:
                        choice = f"{e[1].split('.')[-1]}_{base}"
                    while choice in taken:
                        choice += "_"
                taken[choice] = e
                self.locals[t, e] = choice
            # does an import's local name hide a builtin that another member uses, or is it hidden where it is used?
            for m, stmts in members.items():
                mod = self.modules[m]
                for s in stmts:
                    for name, node, kind, visible, fs, deferred in s.found:
                        b = mod.bind.get(name)
                        if b is None:
                            if name in taken and taken[name] is not None and kind != "name?":
                                e = taken[name]
                                fail(f"{t}: import {e} hides the builtin {name} used in {m}")
                            continue
                        e = self.entity(m, name)
                        new = self.locals.get((t, e))
                        if new and new != name and new in visible:
                            # choose this member's name for all
                            other = name
                            if other in taken and taken[other] not in (None, e):
                                fail(f"{t}: {e}: no name that is free everywhere")
                            self.locals[t, e] = other
            self.need_runtime[t] = {e: tcs[e] for e in wanted}

    def reexported(self, m, name):
        if not hasattr(self, "_reexp"):
            self._reexp = set()
            for mod in self.modules.values():
                for b in mod.bind.values():
                    if b.kind == "from":
                        self._reexp.add((b.source, b.attr))
        return False

    def entity_target(self, e):
        if e[0] == "sym":
            return self.sym_target(e[1], e[2])
        if e[0] == "mod":
            return self.target[e[1]]
        return None

    def edges_and_order(self):
        self.edges = collections.defaultdict(dict)
        for t, needs in self.need_runtime.items():
            for e, tc in needs.items():
                o = self.entity_target(e)
                if o and o != t:
                    if not tc or o not in self.edges[t]:
                        self.edges[t][o] = (tc and self.edges[t].get(o, (True,))[0], e)
        # lazy ones, for the check of layers only
        self.lazy_edges = collections.defaultdict(dict)
        for t, members in self.groups.items():
            for m, stmts in members.items():
                for s in stmts:
                    for node, _ in s.lazy:
                        for o, e in self.lazy_targets(node):
                            if o != t:
                                self.lazy_edges[t].setdefault(o, (m, e))

    def lazy_targets(self, node):
        if isinstance(node, ast.ImportFrom) and node.module:
            for a in node.names:
                full = f"{node.module}.{a.name}"
                if full in self.modules and full not in SHADOWED:
                    yield self.target[full], full
                elif node.module in self.modules:
                    e = self.imported(node.module, a.name)
                    o = self.entity_target(e)
                    if o:
                        yield o, e
        elif isinstance(node, ast.Import):
            for a in node.names:
                if a.name in self.modules:
                    yield self.target[a.name], a.name

    # -- order of members within a target
    def ordered(self, t):
        members = self.groups[t]
        names = list(members)
        if len(names) == 1:
            return [(names[0], s) for s in members[names[0]]]
        deps = collections.defaultdict(set)
        for m in names:
            mod = self.modules[m]
            for s in members[m]:
                for name, node, kind, visible, fs, deferred in s.found:
                    b = mod.bind.get(name)
                    if b is None or b.tc:
                        continue
                    e = self.entity(m, name)
                    if e[0] == "sym" and e[1] != m and self.sym_target(e[1], e[2]) == t:
                        deps[m].add(e[1])
                    elif e[0] == "mod" and self.target[e[1]] == t:
                        deps[m].add(e[1])
        done, out = set(), []

        def visit(m, path):
            if m in done:
                return
            if m in path:
                cyc = path[path.index(m):]
                print(f"note {t}: members import each other: {' '.join(cyc)}")
                return
            for d in names:
                if d in deps[m]:
                    visit(d, [*path, m])
            done.add(m)
            out.append(m)

        for m in names:
            visit(m, [])
        return [(m, s) for m in out for s in members[m]]

    # -- edits of a statement
    def edits(self, t, m, s):
        mod = self.modules[m]
        T = mod.text
        out = []
        fstr = collections.defaultdict(dict)
        modattrs = {}
        for n in ast.walk(s.node):
            if isinstance(n, ast.Attribute) and isinstance(n.value, ast.Name):
                modattrs[id(n.value)] = n
        for name, node, kind, visible, fs, deferred in s.found:
            if kind == "name?":
                continue
            b = mod.bind.get(name)
            if b is None:
                continue
            e = self.entity(m, name)
            if e[0] == "mod":
                ot = self.target[e[1]]
                attr = modattrs.get(id(node))
                if attr is not None:
                    e2 = self.entity(e[1], attr.attr)
                    a, z = T.span(attr)
                    if e2[0] == "sym" and self.sym_target(e2[1], e2[2]) == t:
                        new = self.newname(e2[1], e2[2])
                        if new in visible:
                            fail(f"{t}: {m}: {name}.{attr.attr} becomes {new}, which is local there")
                        if fs is not None:
                            fstr[id(fs)][f"{name}.{attr.attr}"] = new
                            fstr[id(fs)]["node"] = fs
                        else:
                            out.append((a, z, new))
                        continue
                    if e2[0] == "sym":
                        new = self.newname(e2[1], e2[2])
                        if self.sym_target(e2[1], e2[2]) != ot:
                            fail(f"{t}: {m}: {name}.{attr.attr} is in another file now: {self.sym_target(e2[1], e2[2])}")
                        if new != attr.attr:
                            out.append((z - len(attr.attr), z, new))
                elif ot == t:
                    fail(f"{t}: {m} uses the module {name} itself")
                new = self.locals.get((t, e), name)
            elif e[0] == "sym" and self.sym_target(e[1], e[2]) == t and e[2] in self.modules[e[1]].bind:
                new = self.newname(e[1], e[2])
                if new != name and new in visible:
                    fail(f"{t}: {m}: {name} becomes {new}, which is local there")
            else:
                new = self.locals.get((t, e), name)
            if new == name:
                continue
            if kind == "string":
                a, z = T.span(node)
                out.append((a, z, re.sub(rf"\b{name}\b", new, T.src[a:z])))
            elif kind == "global":
                a, z = T.span(node)
                out.append((a, z, re.sub(rf"\b{name}\b", new, T.src[a:z])))
            elif fs is not None:
                fstr[id(fs)][name] = new
                fstr[id(fs)]["node"] = fs
            else:
                out.append((*T.span(node), new))
        for names in fstr.values():
            node = names.pop("node")
            a, z = T.span(node)
            out.append((a, z, rename_in_fstring(T.src[a:z], names)))
        # the definition's own name
        if isinstance(s.node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)):
            new = self.newname(m, s.node.name)
            if new != s.node.name:
                a = T.at(s.node.lineno, s.node.col_offset)
                k = re.compile(rf"(?:async\s+def|def|class)\s+({s.node.name})\b").search(T.src, a)
                out.append((k.start(1), k.end(1), new))
        for node, visible in s.lazy:
            out += self.lazy_edit(t, m, s, node)
        # dotted names in strings and comments
        out += self.string_edits(T.src, s.start, s.end, out)
        return out

    def render(self, t, m, s):
        T = self.modules[m].text
        return apply_edits(T.src, s.start, s.end, self.edits(t, m, s))

    def lazy_edit(self, t, m, s, node):
        """A function's own import."""
        T = self.modules[m].text
        if isinstance(node, ast.Import):
            if any(a.name in self.modules for a in node.names):
                fail(f"{m}: import of {node.names[0].name} in a function")
            return []
        if not node.module or not (node.module in self.modules or any(f"{node.module}.{a.name}" in self.modules for a in node.names)):
            return []
        lines, drop = collections.OrderedDict(), []
        edits = []
        for a in node.names:
            local = a.asname or a.name
            full = f"{node.module}.{a.name}"
            e = ("mod", full) if full in self.modules and full not in SHADOWED else self.imported(node.module, a.name)
            o = self.entity_target(e)
            if o is None:
                lines.setdefault(e[1], []).append((e[2], local))
                continue
            if o == t:
                if e[0] == "mod":
                    for n in ast.walk(s.node):
                        if isinstance(n, ast.Attribute) and isinstance(n.value, ast.Name) and n.value.id == local:
                            e2 = self.entity(full, n.attr)
                            edits.append((*T.span(n), self.newname(e2[1], e2[2])))
                    continue
                new = self.newname(e[1], e[2])
                if new != local:
                    fn = enclosing(s.node, node)
                    for n in ast.walk(fn):
                        if isinstance(n, ast.Name) and n.id == local:
                            edits.append((*T.span(n), new))
                continue
            if e[0] == "mod":
                p, _, leaf = o.rpartition(".")
                lines.setdefault(p, []).append((leaf, local))
                for n in ast.walk(s.node):
                    if isinstance(n, ast.Attribute) and isinstance(n.value, ast.Name) and n.value.id == local:
                        e2 = self.entity(full, n.attr)
                        if e2[0] == "sym" and self.newname(e2[1], e2[2]) != n.attr:
                            z = T.span(n)[1]
                            edits.append((z - len(n.attr), z, self.newname(e2[1], e2[2])))
            else:
                lines.setdefault(o, []).append((self.newname(e[1], e[2]), local))
        a, z = T.span(node)
        indent = " " * node.col_offset
        comment = ""
        line = T.lines[node.end_lineno - 1]
        text = ("\n" + indent).join(
            f"from {p} import " + ", ".join(n if n == l else f"{n} as {l}" for n, l in names) for p, names in lines.items()
        )
        if not text:
            body = body_of(s.node, node)
            if len(body) == 1:
                text = "pass"
            else:
                # the whole line goes
                a = T.starts[node.lineno - 1]
                z = T.starts[node.end_lineno]
                if T.src[z : z + 1] == "\n":
                    z += 1
        if text != T.src[a:z]:
            edits.append((a, z, text))
        return edits

    # -- names in text
    def dotted(self, text):
        """The new form of `haptorb.a.b`, `haptorb.a.b.name`, `haptorb.a.b:name`; None if nothing changes."""
        head, colon, tail = text.partition(":")
        parts = head.split(".")
        for n in range(len(parts), 1, -1):
            old = ".".join(parts[:n])
            if old in self.modules and old not in self.dropped:
                rest = parts[n:]
                new = self.target[old]
                if rest:
                    e = self.imported(old, rest[0])
                    if e[0] == "sym" and e[2] in self.modules[e[1]].bind and not (self.modules[old].is_pkg and self.target[old] == old):
                        new = self.sym_target(e[1], e[2])
                        rest = [self.newname(e[1], e[2]), *rest[1:]]
                    elif e[0] == "ext" and (new, e) in self.locals:
                        rest = [self.locals[new, e], *rest[1:]]
                if colon and tail and re.fullmatch(r"\w+", tail):
                    e = self.imported(old, tail)
                    if e[0] == "sym" and not (self.modules[old].is_pkg and e[1] == old) and e[2] in self.modules[e[1]].bind:
                        new = self.sym_target(e[1], e[2])
                        tail = self.newname(e[1], e[2])
                return ".".join([new, *rest]) + colon + tail
            if old in self.modules and old in self.dropped:
                new = self.pkg_target(old)
                if len(parts) > n:  # a name of the package
                    return ".".join([new, *parts[n:]]) if parts[n].startswith("__") else None
                return new + colon + tail
        return None

    def pkg_target(self, old):
        if old in self.map.target:
            return self.map.target[old]
        if old in self.map.texts:
            return self.map.texts[old]
        below = collections.Counter(t for m, t in self.target.items() if m.startswith(old + "."))
        if len(below) == 1:
            return next(iter(below))
        if not below:
            return old
        named = [t for t in below if t.rpartition(".")[2] == old.rpartition(".")[2]]
        if named:
            return named[0]
        common = None
        for t in below:
            parts = t.split(".")
            common = parts if common is None else [a for a, b in zip(common, parts) if a == b] if False else prefix_of(common, parts)
        guess = ".".join(common)
        self.guessed = getattr(self, "guessed", {})
        self.guessed[old] = guess
        return guess

    DOTTED = re.compile(r"(?<![\w./-])haptorb(?:_\w+)?(?:\.\w+)+(?::\w+)?")
    PATH = re.compile(r"(?<![\w-])(?:(?:\.\./)*(?:[\w.-]+/)*?)?((?:[a-z_0-9]+/)+[a-z_0-9]+\.py)\b")

    IMPORT = re.compile(r"from (haptorb(?:_\w+)?(?:\.\w+)*) import (\([^()]*\)|\w+(?: as \w+)?(?:, \w+(?: as \w+)?)*)")

    def import_in_text(self, k, src):
        """An import in a program that is a string, a docstring or a document; None if it names none of ours."""
        module, names = k[1], k[2].strip("()").replace("\n", " ")
        if module not in self.modules:
            return None
        lines = collections.OrderedDict()
        for one in filter(None, (x.strip() for x in names.split(","))):
            name, _, local = one.partition(" as ")
            local = local or name
            full = f"{module}.{name}"
            e = ("mod", full) if full in self.modules and full not in SHADOWED else self.imported(module, name)
            if e[0] == "mod":
                p, _, leaf = self.target[e[1]].rpartition(".")
                lines.setdefault(p, []).append((leaf, local))
            elif e[0] == "ext":
                lines.setdefault(self.target[module], []).append((name, local))
            else:
                lines.setdefault(self.sym_target(e[1], e[2]), []).append((self.newname(e[1], e[2]), local))
        before = src[src.rfind("\n", 0, k.start()) + 1 : k.start()]
        glue = "\n" + before if not before.strip() else "; "
        texts = []
        for p, some in lines.items():
            inside = ", ".join(n if n == l else f"{n} as {l}" for n, l in some)
            texts.append(f"from {p} import ({inside})" if k[2].startswith("(") and len(lines) == 1 and len(inside) > 90 else f"from {p} import {inside}")
        return glue.join(texts)

    def string_edits(self, src, start, end, taken):
        out = []
        spans = sorted((a, z) for a, z, _ in taken)

        def free(a, z):
            return not any(x < z and a < y for x, y in spans)

        for k in self.IMPORT.finditer(src, start, end):
            if not free(k.start(), k.end()):
                continue
            new = self.import_in_text(k, src)
            if new is not None:
                spans.append((k.start(), k.end()))
                if new != k.group():
                    out.append((k.start(), k.end(), new))
        for k in self.DOTTED.finditer(src, start, end):
            text = k.group()
            new = self.dotted(text)
            if new and new != text and free(k.start(), k.end()):
                out.append((k.start(), k.end(), new))
                spans.append((k.start(), k.end()))
        for k in re.compile(r"(?<![\w-])(?:[\w.-]+/)*[\w]+\.py\b").finditer(src, start, end):
            text = k.group()
            new = self.path(text)
            if new and new != text and free(k.start(), k.end()):
                out.append((k.start(), k.end(), new))
        for k in re.compile(r"(?<![\w./-])(?:[\w.-]+/)+[\w.-]*").finditer(src, start, end):
            text = k.group()
            new = self.folder(text)
            if new and new != text and free(k.start(), k.end()):
                out.append((k.start(), k.end(), new))
        return out

    def path(self, text):
        for lead in ("src/haptorb/", "haptorb/", ""):
            if text.startswith(lead):
                rel = text[len(lead):]
                if not lead and "/" not in rel:
                    return None
                old = "haptorb." + rel[:-3].replace("/", ".")
                old = old.removesuffix(".__init__")
                if old in self.modules:
                    new = self.target[old]
                    if old in self.dropped or new == old:
                        return None
                    suffix = "/__init__.py" if self.target_pkg(new) else ".py"
                    new = new.replace(".", "/") + suffix
                    if lead == "src/haptorb/":
                        return "src/" + new
                    return new if lead == "haptorb/" else new.removeprefix("haptorb/")
        for old, new in self.moved_files.items():
            if text == old:
                return new
        return None

    def folder(self, text):
        best = None
        for old, new in self.map.folders:
            if old == new:
                continue
            if text.rstrip("/") == old or text.startswith(old + "/"):
                if best is None or len(old) > len(best[0]):
                    best = (old, new)
        return best[1] + text[len(best[0]):] if best else None

    @property
    def moved_files(self):
        return self._moved if hasattr(self, "_moved") else {}

    # -- a whole file
    def file_text(self, t):
        members = self.groups[t]
        order = self.ordered(t)
        main_doc = ""
        given = self.map.doctext.get(t)
        names = list(members)
        first = self.map.order[t][0] if self.map.order.get(t) else names[0]
        doc = given or self.modules[first].doc
        comments = {}
        for m in names:
            if self.target[m] == t and m != first and self.modules[m].doc and members[m]:
                if ">>>" in self.modules[m].doc or re.search(r"[∫Σ]", self.modules[m].doc) and False:
                    doc += "\n\n" + self.modules[m].doc
                else:
                    comments[m] = self.modules[m].doc
        if given and self.target[first] == t and self.modules[first].doc != given:
            comments[first] = self.modules[first].doc
        out = []
        if doc:
            raw = "r" if "\\" in doc else ""
            doc = self.retext(doc)
            out.append(f'{raw}"""{doc}"""\n' if "\n" not in doc else f'{raw}"""{doc}\n"""\n')
        if any(self.modules[m].future for m in names):
            out.append("\nfrom __future__ import annotations\n")
        heads = [self.modules[m].header for m in names if self.modules[m].header and self.target[m] == t]
        runtime, typing_ = [], []
        for e, tc in self.need_runtime[t].items():
            local = self.locals[t, e]
            line = self.import_line(t, e, local)
            (typing_ if tc else runtime).append(line)
        if typing_:
            runtime.append("from typing import TYPE_CHECKING")
        for h in heads:
            runtime.insert(0, self.retext(h.rstrip("\n")))
        out.append("\n" + "\n".join(sorted(set(runtime), key=lambda l: (l.startswith("from"), l)) if not heads else runtime) + "\n")
        if typing_:
            out.append("\nif TYPE_CHECKING:\n" + "".join(f"    {l}\n" for l in sorted(set(typing_))))
        alls = set()
        has_all = False
        for m in names:
            mod = self.modules[m]
            if mod.all is None:
                continue
            has_all = has_all or self.target[m] == t
            for n in mod.all:
                e = self.entity(m, n) if n in mod.bind else ("sym", m, n)
                if n in mod.bind and mod.bind[n].kind != "def":
                    if e[0] == "sym" and self.sym_target(e[1], e[2]) == t:
                        alls.add(self.newname(e[1], e[2]))
                    elif self.target[m] == t and (t, e) in self.locals:
                        alls.add(self.locals[t, e])
                elif self.sym_target(m, n) == t:
                    alls.add(self.newname(m, n))
        if has_all:
            out.append("\n__all__ = [" + ", ".join(f'"{n}"' for n in sorted(alls, key=lambda n: (not n.isupper(), not n[0].isupper(), n))) + "]\n")
        seen = set()
        mains = []
        several = sum(bool(members[m]) for m in names) > 1
        for m, s in order:
            if id(s) in self.skip:
                continue
            text = self.render(t, m, s)
            if s.main:
                mains.append("\n\n" + text)
                continue
            if several and m not in seen:
                seen.add(m)
                out.append("\n\n")
                if m in comments:
                    out.append(self.comment(comments[m]))
            simple = isinstance(s.node, (ast.Assign, ast.AnnAssign, ast.Expr, ast.Assert, ast.AugAssign))
            gap = "\n\n" if not simple else ""
            if simple:
                before = self.modules[m].text.src[: s.start]
                gap = "\n" * min(2, len(before) - len(before.rstrip("\n")) - 1) if before.endswith("\n") else "\n"
            out.append(gap + text)
        if len(mains) > 1:
            fail(f"{t}: {len(mains)} processes' entry points")
        return "".join(out + mains)

    def retext(self, text):
        return apply_edits(text, 0, len(text), self.string_edits(text, 0, len(text), []))

    def comment(self, doc):
        doc = self.retext(doc)
        lines = ["# " + "-" * 98]
        for line in doc.splitlines():
            if len(line) > 116:
                lead = line[: len(line) - len(line.lstrip())]
                lines += ["# " + one for one in textwrap.wrap(line, 116, subsequent_indent=lead)]
            else:
                lines.append(("# " + line).rstrip())
        return "\n".join(lines) + "\n\n"

    def import_line(self, t, e, local):
        comment = ""
        for m in self.groups[t]:
            for name, b in self.modules[m].bind.items():
                if b.comment and b.kind != "def" and self.entity(m, name) == e:
                    comment = "  " + b.comment
        if e[0] == "sym":
            o, n = self.sym_target(e[1], e[2]), self.newname(e[1], e[2])
            keep = local == n and self.modules.get(t) and self.modules[t].is_pkg and self.modules[t].all is None
            init = any(self.modules[m].is_pkg and self.modules[m].all is None and n in self.modules[m].bind and self.modules[m].bind[n].kind != "def" for m in self.groups[t])
            return f"from {o} import {n}" + (f" as {local}" if local != n or init else "") + comment
        if e[0] == "mod":
            p, _, leaf = self.target[e[1]].rpartition(".")
            return f"from {p} import {leaf}" + (f" as {local}" if local != leaf else "") + comment
        _, module, attr, _ = e
        if attr:
            return f"from {module} import {attr}" + (f" as {local}" if local != attr else "") + comment
        if local == module.split(".")[0]:
            return f"import {module}{comment}"
        return f"import {module} as {local}{comment}"

    # -- other files
    def other_python(self, path):
        src = path.read_text(encoding="utf-8")
        if "haptorb" not in src and ".py" not in src and "/" not in src:
            return src
        T = Text(src)
        try:
            tree = ast.parse(src)
        except SyntaxError:
            return apply_edits(src, 0, len(src), self.string_edits(src, 0, len(src), []))
        out = []
        aliases = {}
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] == "haptorb":
                lines = collections.OrderedDict()
                for a in node.names:
                    local = a.asname or a.name
                    full = f"{node.module}.{a.name}"
                    if full in self.modules and full not in SHADOWED:
                        aliases[local] = full
                        t = self.target[full] if full not in self.dropped else self.pkg_target(full)
                        p, _, leaf = t.rpartition(".")
                        if not p:
                            p, leaf = t, t
                        lines.setdefault(p, []).append((leaf, local))
                    elif node.module in self.modules:
                        e = self.imported(node.module, a.name)
                        if e[0] == "mod":
                            p, _, leaf = self.target[e[1]].rpartition(".")
                            aliases[local] = e[1]
                            lines.setdefault(p, []).append((leaf, local))
                        elif e[0] == "ext":
                            if e[2]:
                                lines.setdefault(self.target[node.module], []).append((self.locals.get((self.target[node.module], e), a.name), local))
                            else:
                                lines.setdefault(self.target[node.module], []).append((a.name, local))
                        else:
                            lines.setdefault(self.sym_target(e[1], e[2]), []).append((self.newname(e[1], e[2]), local))
                    else:
                        lines.setdefault(node.module, []).append((a.name, local))
                a, z = T.span(node)
                indent = " " * node.col_offset
                tail = T.lines[node.end_lineno - 1]
                text = ("\n" + indent).join(
                    f"from {p} import " + ", ".join(n if n == l and a2 else f"{n} as {l}" for n, l in names for a2 in [n == l])
                    for p, names in lines.items()
                )
                old = ast.unparse(node)
                if text.replace("\n" + indent, "\n") != old:
                    out.append((a, z, text))
                else:
                    out.append((a, z, src[a:z]))
            elif isinstance(node, ast.Import):
                for al in node.names:
                    if al.name in self.modules and al.asname:
                        aliases[al.asname] = al.name
        for node in ast.walk(tree):
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in aliases:
                old = aliases[node.value.id]
                if old in self.dropped:
                    continue
                new = self.local_attr(old, node.attr)
                if new != node.attr:
                    z = T.span(node)[1]
                    out.append((z - len(node.attr), z, new))
                e = self.entity(old, node.attr)
                if e[0] == "sym" and self.sym_target(e[1], e[2]) != self.target[old] and e[1] == old:
                    fail(f"{path}: {node.value.id}.{node.attr} is in another file now")
            if isinstance(node, ast.Call) and len(node.args) >= 2 and isinstance(node.args[0], ast.Name) and node.args[0].id in aliases:
                c = node.args[1]
                if isinstance(c, ast.Constant) and isinstance(c.value, str):
                    new = self.local_attr(aliases[node.args[0].id], c.value)
                    if new != c.value:
                        a, z = T.span(c)
                        out.append((a, z, f'"{new}"'))
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and node.module:
                new = self.folder("tests/" + node.module.replace(".", "/"))
                if new and new.startswith("tests/"):
                    k = re.compile(re.escape(node.module)).search(src, T.span(node)[0])
                    out.append((k.start(), k.end(), new[6:].replace("/", ".")))
        out += self.mutation_edits(path, T, tree)
        out += self.string_edits(src, 0, len(src), out)
        return apply_edits(src, 0, len(src), out)

    def local_attr(self, old, attr):
        e = self.entity(old, attr)
        t = self.target[old]
        if e[0] == "sym" and e[2] in self.modules[e[1]].bind:
            if self.sym_target(e[1], e[2]) == t:
                return self.newname(e[1], e[2])
            return self.locals.get((t, e), attr)
        return self.locals.get((t, e), attr)

    def mutation_edits(self, path, T, tree):
        """Mutation("physics/beams.py", "scope", "name#1@…", …): file, scope and name after the moves."""
        if path.name != "physics_mutations.py":
            return []
        constants = {}
        for n in tree.body:
            if isinstance(n, ast.Assign):
                targets = n.targets[0]
                pairs = zip(targets.elts, n.value.elts) if isinstance(targets, ast.Tuple) and isinstance(n.value, ast.Tuple) else [(targets, n.value)]
                for a, b in pairs:
                    if isinstance(a, ast.Name) and isinstance(b, ast.Constant):
                        constants[a.id] = b.value
        out = []
        for n in ast.walk(tree):
            if not (isinstance(n, ast.Call) and isinstance(n.func, ast.Name) and n.func.id == "Mutation"):
                continue
            f = n.args[0]
            try:
                file = eval(compile(ast.Expression(f), "", "eval"), {}, constants)
            except Exception as cause:
                fail(f"{path}:{n.lineno}: {cause}")
                continue
            old = "haptorb." + file[:-3].replace("/", ".")
            if old not in self.modules:
                continue
            factor = ast.literal_eval(n.args[3])
            title = lambda f, a, b: f"{f}, " + (f"{a}: {b} " if a else f"{b} ") + ("left out" if factor is None else f"× {factor:g}")
            scope, name = n.args[1], n.args[2]
            top = (scope.value or name.value).split(".")[0]
            top = re.match(r"\w*", top).group()
            t = self.sym_target(old, top)
            suffix = "/__init__.py" if self.target_pkg(t) else ".py"
            newfile = t.removeprefix("haptorb.").replace(".", "/") + suffix
            if newfile != file:
                out.append((*T.span(f), f'"{newfile}"'))
            elif not isinstance(f, ast.Constant):
                out.append((*T.span(f), f'"{newfile}"'))
            newtop = self.newname(old, top)
            if newtop != top:
                c = scope if scope.value else name
                out.append((*T.span(c), '"' + newtop + c.value[len(top):] + '"'))
            a, b = scope.value, name.value
            if newtop != top:
                a, b = (newtop + a[len(top):], b) if a else (a, newtop + b[len(top):])
            self.record[title(file, scope.value, name.value)] = title(newfile, a, b)
        return out

    record: dict[str, str] = {}
    kept = {"haptorb", "haptorb.__main__", "haptorb.errors", "haptorb.version", "haptorb.runtime", "haptorb.worlds", "haptorb.devices", "haptorb.control", "haptorb.simulation", "haptorb.runtime.drivers", "haptorb.runtime.trackers"}

    def plain(self, path):
        src = path.read_text(encoding="utf-8")
        if path.name == "physics_mutations.json":
            self.other_python(path.with_suffix(".py"))
            src = re.sub(r'"([^"\\]*)"', lambda k: '"' + self.record.get(k[1], k[1]) + '"', src)
            return src
        new = apply_edits(src, 0, len(src), self.string_edits(src, 0, len(src), []))
        if new != src:
            for _ in range(4):  # "`serial.py`, `serial.py`"
                new = re.sub(r"(`[\w/]+\.py`)(?:, | and )\1", r"\1", new)
        return new

    def circles(self):
        graph = {t: {o: 1 for o, (tc, e) in outs.items() if not tc} for t, outs in self.edges.items()}
        return [c for c in sccs(graph) if len(c) > 1]

    # -- the check
    def layers_report(self, kinds=("runtime",)):
        graph = collections.defaultdict(dict)
        for t, outs in self.edges.items():
            for o, (tc, e) in outs.items():
                if "tc" in kinds or not tc:
                    graph[t][o] = e
        if "lazy" in kinds:
            for t, outs in self.lazy_edges.items():
                for o, e in outs.items():
                    graph[t].setdefault(o, e)
        comps = sccs(graph)
        bad = [c for c in comps if len(c) > 1]
        for c in bad:
            print(f"CYCLE ({'+'.join(kinds)}) of {len(c)}: {' '.join(sorted(x.removeprefix('haptorb.') for x in c))}")
            for t in sorted(c):
                for o in sorted(graph[t]):
                    if o in c:
                        print(f"    {t.removeprefix('haptorb.')} -> {o.removeprefix('haptorb.')}: {self.who(t, o)}")
        return bad

    def who(self, t, o):
        out = []
        for e, tc in self.need_runtime[t].items():
            if self.entity_target(e) == o:
                users = sorted({m.rpartition(".")[2] for m in self.groups[t] for n, b in self.modules[m].bind.items() if b.kind != "def" and self.entity(m, n) == e})
                out.append(f"{'/'.join(users)}→{'.'.join(e[1].split('.')[-1:])}{':' + e[2] if e[0] == 'sym' else ''}{'(tc)' if tc else ''}")
        if o in self.lazy_edges.get(t, {}):
            m, e = self.lazy_edges[t][o]
            out.append(f"lazy {m.rpartition('.')[2]}→{e[1:] if isinstance(e, tuple) else e}")
        return "; ".join(out[:6])


def prefix_of(a, b):
    out = []
    for x, y in zip(a, b):
        if x != y:
            break
        out.append(x)
    return out


def enclosing(top, node):
    best = top
    for n in ast.walk(top):
        if isinstance(n, (ast.FunctionDef, ast.AsyncFunctionDef)) and any(c is node for c in ast.walk(n)):
            best = n
    return best


def body_of(top, node):
    for n in ast.walk(top):
        for f in ("body", "orelse", "finalbody"):
            b = getattr(n, f, None)
            if isinstance(b, list) and any(x is node for x in b):
                return b
    return [node, node]


def rename_in_fstring(text, names):
    out, depth, i = [], 0, 0
    seg = ""
    result = ""
    while i < len(text):
        c = text[i]
        if depth == 0:
            if text.startswith("{{", i):
                result += "{{"
                i += 2
                continue
            if c == "{":
                depth, seg = 1, ""
                result += c
                i += 1
                continue
            result += c
        else:
            if c == "{":
                depth += 1
            elif c == "}":
                depth -= 1
                if depth == 0:
                    for old, new in names.items():
                        seg = re.sub(rf"(?<![\w.]){re.escape(old)}(?!\w)", new, seg)
                    result += seg + "}"
                    i += 1
                    continue
            seg += c
        i += 1
    return result


def apply_edits(src, start, end, edits):
    edits = sorted(set(e for e in edits if start <= e[0] and e[1] <= end))
    out, at = [], start
    for a, z, new in edits:
        if a < at:
            if new != src[a:z]:
                fail(f"edits overlap: {src[a:z]!r} → {new!r}")
            continue
        out += [src[at:a], new]
        at = z
    out.append(src[at:end])
    return "".join(out)


def sccs(graph):
    index, low, on, stack, out, n = {}, {}, set(), [], [], [0]
    sys.setrecursionlimit(10000)

    def go(v):
        index[v] = low[v] = n[0]
        n[0] += 1
        stack.append(v)
        on.add(v)
        for w in graph.get(v, {}):
            if w not in index:
                go(w)
                low[v] = min(low[v], low[w])
            elif w in on:
                low[v] = min(low[v], index[w])
        if low[v] == index[v]:
            comp = []
            while True:
                w = stack.pop()
                on.discard(w)
                comp.append(w)
                if w == v:
                    break
            out.append(comp)

    for v in list(graph):
        if v not in index:
            go(v)
    return out


# ------------------------------------------------------------------ commands
TEXTS = {".md", ".toml", ".json", ".mjs", ".ts", ".yml", ".yaml", ".html", ".rst", ".txt", ".bib", ".css", ".cfg", ".sh", ".inc", ".c", ".h"}


def project_files(root):
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=root, capture_output=True, text=True, check=True).stdout
    return [root / n for n in listed.split("\0") if n and (root / n).is_file()]


def apply(fold):
    root = fold.root
    if fold.layers_report():
        print("circles of imports: nothing written")
        return 1
    changed = [t for t, members in fold.groups.items()]
    texts = {}
    # which files move: tests and data
    moved = {}
    files = project_files(root)
    for path in files:
        rel = path.relative_to(root).as_posix()
        new = fold.folder(rel)
        if new and not (rel.startswith("src/") and rel.endswith(".py")):
            moved[rel] = new
    fold._moved = moved
    for t in changed:
        texts[t] = fold.file_text(t)
    others = {}
    for path in files:
        rel = path.relative_to(root).as_posix()
        if rel.startswith("src/") and path.suffix == ".py":
            continue
        if rel in ("CHANGELOG.md",) or "package-lock" in rel:
            continue
        if path.suffix == ".py" or path.name.endswith(".py.txt"):
            text = fold.other_python(path)
        elif path.suffix in TEXTS or path.name in ("Makefile", ".gitignore") or (rel.startswith("scripts/") and not path.suffix):
            try:
                text = fold.plain(path)
            except UnicodeDecodeError:
                continue
        else:
            continue
        if text != path.read_text(encoding="utf-8"):
            others[path] = text
    if FAULTS:
        print(f"{len(FAULTS)} faults: nothing written")
        return 1
    touched = 0
    for path, text in others.items():
        path.write_text(text, encoding="utf-8")
        touched += 1
    # the sources
    written = {}
    for t, text in texts.items():
        is_pkg = fold.target_pkg(t)
        path = fold.src.joinpath(*t.split("."))
        path = path / "__init__.py" if is_pkg else path.with_suffix(".py")
        written[path] = text
    # git mv keeps history: each new file follows its first member
    gone = {mod.path for m, mod in fold.modules.items()} - set(written)
    for path, text in written.items():
        t = ".".join(path.relative_to(fold.src).with_suffix("").parts).removesuffix(".__init__")
        members = list(fold.groups[t])
        only = fold.modules[members[0]]
        if len(members) == 1 and only.path == path and fold.untouched(t):
            new = fold.inplace(t)
        else:
            new = text
        if path.is_file() and path.read_text(encoding="utf-8") == new:
            continue
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(new, encoding="utf-8")
    for path in gone:
        path.unlink()
    for rel, new in moved.items():
        dest = root / new
        if dest.suffix == ".py" and (deeper := new.count("/") - rel.count("/")):
            text = (root / rel).read_text(encoding="utf-8")
            old = max((o for o, _ in fold.map.folders if rel.startswith(o + "/")), key=len)
            inside = rel[len(old) + 1 :].count("/") + 1  # what lies in the moved folder moves along
            text = re.sub(
                r"(__file__\)(?:\.resolve\(\))?\.parents\[)(\d+)\]",
                lambda k: f"{k[1]}{int(k[2]) + (deeper if int(k[2]) >= inside else 0)}]",
                text,
            )
            (root / rel).write_text(text, encoding="utf-8")
        dest.parent.mkdir(parents=True, exist_ok=True)
        (root / rel).rename(dest)
    for old, new in fold.map.folders:  # what git ignores: built pages
        if (root / old).is_dir() and not (root / new).exists():
            (root / new).parent.mkdir(parents=True, exist_ok=True)
            (root / old).rename(root / new)
    # packages
    for t in written:
        folder = t.parent
        while folder != fold.src:
            init = folder / "__init__.py"
            if not init.is_file():
                name = ".".join(init.parent.relative_to(fold.src).parts)
                text = fold.map.packages.get(name)
                if not text:
                    print(f"note: package {name} has no docstring in the mapping")
                    text = f"The package {name}."
                init.write_text(f'"""{text}"""\n', encoding="utf-8")
            folder = folder.parent
    for folder in sorted((p for top in ("src", "tests") for p in (root / top).rglob("*") if p.is_dir()), key=lambda p: -len(p.parts)):
        left = [p for p in folder.iterdir() if p.name != "__pycache__"]
        if not left:
            for p in folder.rglob("*"):
                if p.is_file():
                    p.unlink()
            for p in sorted(folder.rglob("*"), key=lambda p: -len(p.parts)):
                p.rmdir()
            folder.rmdir()
    for file, pattern, repl in fold.map.patches:
        path = root / file.strip()
        if not path.is_file():
            fail(f"patch: {file} is not there")
            continue
        text = path.read_text(encoding="utf-8")
        pattern = pattern
        repl = expand(fold, repl)
        new, n = re.subn(pattern, repl.replace("\\n", "\n"), text, flags=re.M)
        if not n:
            print(f"PATCH without effect: {file}: {pattern}")
            FAULTS.append("patch")
        path.write_text(new, encoding="utf-8")
    print(f"{len(fold.modules)} modules → {len(written)}; {touched} other files rewritten, {len(moved)} files moved")
    for old, new in sorted(getattr(fold, "guessed", {}).items()):
        print(f"note: {old} in text is written as {new}")
    return 1 if FAULTS else 0


def expand(fold, repl):
    def aliases(k):
        old = {m: t for m, t in fold.target.items() if m.startswith(k[1]) and m != t and m not in fold.dropped}
        return "{" + ", ".join(f'"{m}": "{t}"' for m, t in sorted(old.items())) + "}"

    repl = re.sub(r"@ALIASES\(([\w.]+)\)@", aliases, repl)
    return re.sub(
        r"@FILE\(([\w.-]+)\)@", lambda k: Path(__file__).with_name(k[1]).read_text().replace("\\", "\\\\"), repl
    )


def untouched(self, t):
    """Whether t is one old module in its old place, no definition of it elsewhere."""
    return not any(k[0] == t for k in self.map.syms)


def inplace(self, t):
    """The text of a module that stays: only names that it imports change."""
    m = t
    mod = self.modules[m]
    out = []
    T = mod.text
    src = T.src
    for node in mod.tree.body:
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING" and not node.orelse:
            nodes = node.body
        else:
            nodes = [node]
        for n in nodes:
            if isinstance(n, ast.ImportFrom) and n.module and n.module.split(".")[0].startswith("haptorb"):
                lines = collections.OrderedDict()
                same = True
                for a in n.names:
                    local = a.asname or a.name
                    full = f"{n.module}.{a.name}"
                    e = ("mod", full) if full in self.modules and full not in SHADOWED else self.imported(n.module, a.name) if n.module in self.modules else None
                    new = None
                    if e is None or e[0] == "ext":
                        p, name = n.module, a.name
                    elif e[0] == "mod":
                        p, _, name = self.target[e[1]].rpartition(".")
                    else:
                        p, name = self.sym_target(e[1], e[2]), self.newname(e[1], e[2])
                    new = self.locals.get((t, e), local)
                    lines.setdefault(p, []).append((name, new, a.asname == a.name))
                    same = same and p == n.module and name == a.name and new == local
                a, z = T.span(n)
                if not same:
                    indent = " " * n.col_offset
                    text = ("\n" + indent).join(
                        f"from {p} import " + ", ".join(x if x == l and not k else f"{x} as {l}" for x, l, k in names) for p, names in lines.items()
                    )
                    out.append((a, z, text))
                else:
                    out.append((a, z, src[a:z]))
    for s in mod.stmts:
        out += self.edits(t, m, s)
    out += self.string_edits(src, 0, len(src), out)
    return apply_edits(src, 0, len(src), out)


Fold.untouched, Fold.inplace = untouched, inplace


def main():
    root, mapping, command, *stages = sys.argv[1:]
    fold = Fold(root, mapping, stages)
    print(f"{len(fold.modules)} modules, {len(fold.groups)} files after")
    for m, t in fold.unmapped:
        print(f"note: {m} is new; by rule it goes to {t}")
    if not stages:
        left = [m for m, t in fold.target.items() if m == t and m not in fold.map.target and m not in fold.dropped and m not in fold.kept]
        for m in left:
            print(f"note: {m} has no place in the mapping and no rule: it stays")
    if command == "check":
        for kinds in (("runtime",), ("runtime", "tc", "lazy")):
            fold.layers_report(kinds)
        for t in fold.groups:
            fold.file_text(t)
        auto = {k: v for k, v in fold.forced.items() if k not in fold.map.renames}
        print(f"{len(auto)} names renamed because two members have them")
        if "-v" in stages:
            pass
        for (m, n), v in sorted(auto.items()):
            print(f"  rename {m.removeprefix('haptorb.')}:{n} {v}") if not n.startswith("_") else None
        print(len(FAULTS), "faults")
        return bool(FAULTS)
    if command == "apply":
        return apply(fold)
    if command == "page":
        return page(fold)


def page(fold):
    by = collections.defaultdict(list)
    for m, t in fold.target.items():
        if m != t and m not in fold.dropped:
            by[t].append(m)
    short = lambda n: n.removeprefix("haptorb.").replace(".", "/") + ".py"
    out = [
        "# 50. Where modules went", "",
        "**Context.** 964 modules cut ideas into pieces to keep folders small. Issue 37 made each file one whole idea.", "",
        "**Decision.** Modules moved and merged by a mapping; no definition changed but for names that two of them had.",
        "Layers, from above: `haptorb_papers`, `haptorb_design` and `haptorb_study`, then in `haptorb` `cli`, `serve`, `web`,",
        "`replay`, `runtime`, `recording` with `terminal`, `simulation` and `analysis`, `control`, `estimation` with `worlds`,",
        "`devices`, `magnetics` with `thermal` and `beams`, and what all use. Paths are relative to `src/haptorb` or `src`.", "",
        "**Consequences.** Open work finds its module here. Older recordings name classes by the modules of their time;",
        "`worlds/user_world.py` and `runtime/tick_state.py` know where these are.", "",
        "| file | made from |", "|---|---|",
    ]
    bulk = collections.Counter()
    for t in sorted(by):
        if t.startswith("haptorb_papers."):
            bulk[".".join(t.split(".")[:2])] += 1
            continue
        out.append(f"| `{short(t)}` | {', '.join(f'`{short(m)}`' for m in by[t])} |")
    out += [f"| `{t.replace('.', '/')}/` | {n} files of `apps`, each as it was |" for t, n in sorted(bulk.items())]
    Path(PAGE).write_text("\n".join(out) + "\n", encoding="utf-8")
    return 0


PAGE = "/tmp/where-modules-went.md"

if __name__ == "__main__":
    sys.exit(main())
