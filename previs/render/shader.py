"""Shader programs from files: includes, defines, strict names, and errors that name file and line.

Sources are GLSL 3.30 without a #version line. ``#include "name.glsl"`` takes a file of the shader folder once; defines
are given by the caller. An upper-case name that is tested by ``#if`` and defined nowhere is an error that names it:
GLSL would quietly take it for 0. With PREVIS_SHADER_SOURCE=1 in the environment the numbered source of every program
is printed to stderr.
"""

from __future__ import annotations

import functools
import os
import re
import stat
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import moderngl

_INCLUDE = re.compile(r'^\s*#\s*include\s+"([^"]+)"\s*$')
_CONDITION = re.compile(r"^\s*#\s*(?:if|elif)\s+(.*)$")
_DEFINE = re.compile(r"^\s*#\s*define\s+([A-Za-z_]\w*)")
_NAME = re.compile(r"\b[A-Z][A-Z0-9_]*\b")
_DEFINED = re.compile(r"defined\s*\(?\s*\w+\s*\)?")
_LOG_LINE = re.compile(r"\b(\d+):(\d+)(?:\((\d+)\))?")
_MAX_DEPTH = 8


class ShaderError(RuntimeError):
    """A shader cannot be composed or compiled; the message names file and line."""


def shader_folder() -> Path:
    """Where the shader files are: inside an installed package, or beside it in a source tree."""
    installed = Path(__file__).parent.parent / "_shaders"
    return installed if installed.is_dir() else Path(__file__).parents[2] / "shaders"


@dataclass(frozen=True)
class Source:
    """A composed shader: its text and the files that `#line` numbers refer to."""

    text: str
    files: tuple[str, ...]

    def numbered(self) -> str:
        """The text with line numbers, for reading."""
        return "\n".join(f"{n:5d}  {line}" for n, line in enumerate(self.text.splitlines(), 1))


@dataclass(frozen=True)
class _File:
    """A shader file that was read: its lines, the upper-case names in them, and what the lines with a directive ask
    for, as (index, "include" or "define", name) and (index, "condition", names)."""

    lines: tuple[str, ...]
    names: frozenset[str]
    directives: tuple[tuple[int, str, Any], ...]


@functools.lru_cache(maxsize=256)
def _parsed(path: str, modified: int) -> _File:
    """A file as it was at a time of modification: most are part of many programs."""
    text = Path(path).read_text(encoding="utf-8")
    lines = tuple(text.splitlines())
    directives: list[tuple[int, str, Any]] = []
    for index, line in enumerate(lines):
        if "#" not in line:
            continue
        if match := _INCLUDE.match(line):
            directives.append((index, "include", match[1]))
        elif match := _DEFINE.match(line):
            directives.append((index, "define", match[1]))
        elif match := _CONDITION.match(line):
            condition = _DEFINED.sub("", match[1].split("//")[0])
            directives.append((index, "condition", tuple(_NAME.findall(condition))))
    return _File(lines, frozenset(_NAME.findall(text)), tuple(directives))


def _read(name: str, folder: Path) -> _File | None:
    """A shader file, None where there is none of that name."""
    path = os.path.join(folder, name)
    try:
        status = os.stat(path)
    except OSError:
        return None
    return _parsed(path, status.st_mtime_ns) if stat.S_ISREG(status.st_mode) else None


def compose(name: str, defines: Mapping[str, Any], folder: Path | None = None) -> Source:
    """Compose the shader file `name` with its includes and the given defines.

    Raises:
        ShaderError: for a missing file, includes nested too deeply, or a name tested by #if and never defined.
    """
    folder = folder or shader_folder()
    files: list[str] = []
    seen: set[str] = set()
    known = set(defines) | {"GL_ES", "GL_FRAGMENT_PRECISION_HIGH"}
    lines = ["#version 330 core"]
    lines += [f"#define {key} {_literal(value)}" for key, value in sorted(defines.items())]

    def add(file: str, depth: int, included_from: str) -> None:
        if file in seen:
            return
        if depth > _MAX_DEPTH:
            raise ShaderError(f"{included_from}: includes are nested more than {_MAX_DEPTH} deep")
        source = _read(file, folder)
        if source is None:
            raise ShaderError(f"{included_from}: no shader file {file!r} in {folder}")
        seen.add(file)
        files.append(file)
        number = len(files) - 1
        lines.append(f"#line 1 {number}")
        taken = 0
        for index, kind, wanted in source.directives:
            if kind == "include":
                lines.extend(source.lines[taken:index])
                add(wanted, depth + 1, f"{file}:{index + 1}")
                lines.append(f"#line {index + 2} {number}")
                taken = index + 1
            elif kind == "define":
                known.add(wanted)
            elif missing := [n for n in wanted if n not in known]:
                raise ShaderError(f"{file}:{index + 1}: {missing[0]} is tested but not defined")
        lines.extend(source.lines[taken:])

    add(name, 0, name)
    return Source("\n".join(lines) + "\n", tuple(files))


def _literal(value: Any) -> str:
    if isinstance(value, bool):
        return "1" if value else "0"
    if isinstance(value, float):
        return repr(value)
    return str(value)


class Program:
    """A linked program. Uniforms are set by name; a name that this variant does not use is skipped, so that callers
    need not know the variants."""

    def __init__(self, context: moderngl.Context, vertex: str, fragment: str, defines: Mapping[str, Any]) -> None:
        sources = [compose(vertex, defines), compose(fragment, defines)]
        if os.environ.get("PREVIS_SHADER_SOURCE") == "1":
            for name, source in zip((vertex, fragment), sources, strict=True):
                print(f"--- {name} {dict(defines)}\n{source.numbered()}", file=sys.stderr)
        try:
            self.program = context.program(vertex_shader=sources[0].text, fragment_shader=sources[1].text)
        except moderngl.Error as error:
            raise ShaderError(_explain(str(error), vertex, fragment, sources)) from None
        self._members = {name: self.program[name] for name in self.program}

    def set(self, **values: Any) -> None:
        """Set uniforms: numbers, sequences, or bytes for matrices and arrays. Samplers take their texture unit."""
        for name, value in values.items():
            member = self._members.get(name)
            if member is None:
                continue
            if isinstance(value, bytes):
                member.write(value)
            else:
                member.value = value

    def bind_block(self, name: str, binding: int) -> None:
        """Connect a uniform block to a binding point."""
        member = self._members.get(name)
        if member is not None:
            member.binding = binding

    def release(self) -> None:
        """Free the program."""
        self.program.release()


def _explain(log: str, vertex: str, fragment: str, sources: list[Source]) -> str:
    """The compiler's log with file names in place of file numbers."""
    source = sources[1] if "fragment_shader" in log else sources[0]

    def named(match: re.Match[str]) -> str:
        number = int(match[1])
        if number < len(source.files):
            return f"{source.files[number]}:{match[2]}"
        return match[0]

    return f"{vertex} + {fragment} do not compile:\n{_LOG_LINE.sub(named, log)}"


class ShaderCache:
    """Programs by file names and defines, compiled once; their samplers read the texture units given by name."""

    def __init__(self, context: moderngl.Context, units: Mapping[str, int]) -> None:
        self._context = context
        self._units = units
        self._programs: dict[tuple, Program] = {}
        self._names: dict[str, frozenset[str]] = {}

    def get(self, vertex: str, fragment: str, **defines: Any) -> Program:
        """The program for these files and defines.

        Raises:
            ShaderError: when it cannot be composed or compiled.
        """
        # Only what the sources mention makes a variant: a knob of one pass does not compile the others anew.
        mentioned = self._mentioned(vertex) | self._mentioned(fragment)
        defines = {name: value for name, value in defines.items() if name in mentioned}
        key = (vertex, fragment, tuple(sorted(defines.items())))
        if key not in self._programs:
            program = self._programs[key] = Program(self._context, vertex, fragment, defines)
            # All at once: a sampler left at unit 0 would share it with one of another type, which GL refuses to draw.
            program.set(**self._units)
        return self._programs[key]

    def _mentioned(self, name: str) -> frozenset[str]:
        """All upper-case names in a shader file and in what it includes."""
        if name not in self._names:
            found: set[str] = set()
            pending, seen = [name], set()
            while pending:
                file = pending.pop()
                if file in seen:
                    continue
                seen.add(file)
                source = _read(file, shader_folder())
                if source is not None:
                    found |= source.names
                    pending += [wanted for _, kind, wanted in source.directives if kind == "include"]
            self._names[name] = frozenset(found)
        return self._names[name]

    def release(self) -> None:
        """Free all programs."""
        for program in self._programs.values():
            program.release()
        self._programs.clear()
