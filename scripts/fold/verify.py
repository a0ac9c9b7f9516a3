"""python verify.py OLD NEW MAPPING: every definition of the old tree stands in the new one, the same but for names and imports.

Independent of how fold.py writes files: both trees are parsed again and compared definition by definition.
"""
import ast, collections, sys
from pathlib import Path

old, new = Path(sys.argv[1]), Path(sys.argv[2])


class Plain(ast.NodeTransformer):
    def visit_Name(self, n):
        return ast.Name("_", ast.Load())

    def visit_Attribute(self, n):
        self.generic_visit(n)
        if isinstance(n.value, ast.Name) :
            # module.name may have become name
            return n.value
        return n

    def visit_Import(self, n):
        return None

    visit_ImportFrom = visit_Import

    def visit_Pass(self, n):
        return None

    def visit_Global(self, n):
        return None

    def visit_Constant(self, n):
        if isinstance(n.value, str) and ("haptorb" in n.value or ".py" in n.value):
            return ast.Constant("text")
        return n

    def visit_FunctionDef(self, n):
        self.generic_visit(n)
        n.name = "_" if n.name in TOP else n.name
        return n

    def visit_ClassDef(self, n):
        self.generic_visit(n)
        n.name = "_" if n.name in TOP else n.name
        return n


def shapes(root):
    found = collections.Counter()
    where = {}
    for path in sorted((root / "src").rglob("*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        global TOP
        TOP = {n.name for n in tree.body if isinstance(n, (ast.FunctionDef, ast.ClassDef))}
        for node in tree.body:
            if isinstance(node, (ast.Import, ast.ImportFrom)):
                continue
            if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
                continue
            if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
                continue
            if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__":
                continue
            label = f"{path.relative_to(root)}:{node.lineno} {getattr(node, 'name', ast.unparse(node)[:60])}"
            text = ast.dump(Plain().visit(node))
            found[text] += 1
            where.setdefault(text, []).append(label)
    return found, where


a, wa = shapes(old)
b, wb = shapes(new)
lost, added = a - b, b - a
print(f"{sum(a.values())} definitions before, {sum(b.values())} after; {sum(lost.values())} are not there unchanged, {sum(added.values())} are new or changed")
for t in lost:
    print("  -", lost[t], wa[t][:3])
for t in added:
    print("  +", added[t], wb[t][:3])
