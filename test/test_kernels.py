# Copyright 2026 gyro_drift_filter maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""What holds for all kernels of the package, read off its source.

Python calls entry kernels alone; and the name of the cache's folder covers all that is compiled
into a kernel.
"""

import ast
from functools import cache

from gyro_drift_filter.accelerate.cache import covered_files, kernel_modules
from support.paths import PACKAGE, REPOSITORY

INNER_KERNELS = 'kernel', 'inlined_kernel'
KERNELS = *INNER_KERNELS, 'entry_kernel'


class Module:
    """A module of the package: what its names stand for."""

    def __init__(self, path):
        parts = path.relative_to(REPOSITORY).with_suffix('').parts
        self.path = path
        self.name = '.'.join(parts).removesuffix('.__init__')
        self.tree = ast.parse(path.read_text())
        self.imported = {}  # by name: module, and name there or None for the module itself
        for node in ast.walk(self.tree):
            if isinstance(node, ast.Import):
                self.imported |= {a.asname or a.name: (a.name, None) for a in node.names}
            elif isinstance(node, ast.ImportFrom):
                self.imported |= {a.asname or a.name: (node.module, a.name) for a in node.names}
        self.defined = {}  # by name: the statements that bind it
        for statement in self.tree.body:
            for name in bound(statement):
                self.defined.setdefault(name, []).append(statement)
        self.kernels = {  # by name: its decorator
            node.name: decorator
            for node in self.tree.body
            if isinstance(node, ast.FunctionDef) and (decorator := decorator_of(node))
        }


def bound(statement):
    """Yield the names that a statement of a module binds, or changes what they stand for."""
    if isinstance(statement, (ast.FunctionDef, ast.ClassDef)):
        yield statement.name
        return
    for node in ast.walk(statement):
        if isinstance(node, (ast.Assign, ast.AugAssign, ast.AnnAssign)):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            for target in targets:
                yield from (n.id for n in ast.walk(target) if isinstance(n, ast.Name))


def decorator_of(function):
    for decorator in function.decorator_list:
        node = decorator.func if isinstance(decorator, ast.Call) else decorator
        if isinstance(node, ast.Name) and node.id in KERNELS:
            return node.id
    return None


@cache
def modules():
    found = (Module(path) for path in PACKAGE.rglob('*.py'))
    return {module.name: module for module in found}


def meaning(module, name):
    """Return module and name where a name is defined that is used in a module, None elsewhere."""
    if name in module.defined:
        return module, name
    if name not in module.imported:
        return None
    source, original = module.imported[name]
    if f'{source}.{original}' in modules():
        return modules()[f'{source}.{original}'], None
    return meaning(modules()[source], original) if source in modules() and original else None


def uses(module, node):
    """Yield each use of something of the package in a node: line, module and name there."""
    for part in ast.walk(node):
        found = None
        if not isinstance(part, ast.expr):
            continue
        if isinstance(part, ast.Name) and isinstance(part.ctx, ast.Load):
            found = meaning(module, part.id)
        elif isinstance(part, ast.Attribute) and isinstance(part.value, ast.Name):
            owner = meaning(module, part.value.id)
            if owner is not None and owner[1] is None:
                found = meaning(owner[0], part.attr)
        if found is not None and found[1] is not None:
            yield part.lineno, *found


def test_python_calls_entry_kernels_alone():
    """An inner kernel is plain Python, and slow, in a process with the extension module."""
    wrong = []
    for module in modules().values():
        for statement in module.tree.body:
            if isinstance(statement, ast.FunctionDef) and decorator_of(statement):
                continue
            wrong += [
                f'{module.path.relative_to(REPOSITORY)}:{line} uses {name}'
                for line, owner, name in uses(module, statement)
                if owner.kernels.get(name) in INNER_KERNELS
            ]
    assert not wrong, '\n'.join(sorted(wrong))


def test_the_cache_knows_all_that_kernels_are_compiled_from():
    """Other kernels, constants and records, and what these are made of in their turn."""
    covered = {path.resolve() for path in covered_files()}
    waiting = [(m, name, name) for m in modules().values() for name in m.kernels]
    assert len(waiting) > 100
    seen, wrong = set(), set()
    while waiting:
        module, name, origin = waiting.pop()
        if (module.name, name) in seen:
            continue
        seen.add((module.name, name))
        if module.path.resolve() not in covered:
            wrong.add(f'{module.name}.{name}, for {origin}')
        for statement in module.defined[name]:
            for _, owner, used in uses(module, statement):
                waiting.append((owner, used, origin))
    assert not wrong, '\n'.join(sorted(wrong))
    names = {path.relative_to(PACKAGE).as_posix() for path in covered}
    assert 'core/parameters.py' in names, 'the fields of SETTINGS stand there'
    assert not {name for name in names if name.startswith(('cli/', 'identify/', 'ros/'))}


def test_each_module_with_kernels_is_imported_before_they_are_compiled():
    assert set(kernel_modules()) == {m.name for m in modules().values() if m.kernels}
