"""Shaders from files: includes, defines, errors that name file and line, and every variant that a plan can ask for."""

import itertools
import re
from pathlib import Path

import pytest
from building import box, box_mesh, camera, capsule, distant, index_of, point, scene, smooth_noise, sphere, spot, volume

import previs
from previs import Medium, Settings
from previs.render import shader
from previs.render.method import METHODS
from previs.render.shader import Program, ShaderError, compose, shader_folder
from previs.settings import BY_NAME

VERTEX = "void main() { gl_Position = vec4(0.0); }\n"


def write(folder: Path, **files: str) -> Path:
    for name, text in files.items():
        (folder / f"{name}.glsl").write_text(text)
    return folder


def body(text: str) -> list[str]:
    """The lines of a composed shader that are neither version, defines nor line numbers."""
    return [line for line in text.splitlines() if line and not line.startswith(("#version", "#define", "#line"))]


def test_defines_come_first(tmp_path: Path) -> None:
    """As GLSL literals, after the version."""
    write(tmp_path, main="float x = SCALE;\n")
    text = compose("main.glsl", {"SCALE": 2.0, "COUNT": 3, "ON": True, "OFF": False}, tmp_path).text
    assert text.splitlines()[:5] == [
        "#version 330 core",
        "#define COUNT 3",
        "#define OFF 0",
        "#define ON 1",
        "#define SCALE 2.0",
    ]


def test_a_file_is_included_once(tmp_path: Path) -> None:
    """However many files ask for it; also one that includes itself."""
    write(tmp_path, a='#include "c.glsl"\nint a;\n', b='#include "c.glsl"\nint b;\n', c='#include "c.glsl"\nint c;\n')
    write(tmp_path, main='#include "a.glsl"\n#include "b.glsl"\nint m;\n')
    source = compose("main.glsl", {}, tmp_path)
    assert body(source.text) == ["int c;", "int a;", "int b;", "int m;"]
    assert source.files == ("main.glsl", "a.glsl", "c.glsl", "b.glsl")


def test_a_missing_file_is_named_with_who_wants_it(tmp_path: Path) -> None:
    write(tmp_path, main='\n#include "gone.glsl"\n')
    with pytest.raises(ShaderError, match=r"^main\.glsl:2: no shader file 'gone\.glsl'"):
        compose("main.glsl", {}, tmp_path)
    with pytest.raises(ShaderError, match=r"no shader file 'absent\.frag'"):
        compose("absent.frag", {}, tmp_path)


def test_includes_end_somewhere(tmp_path: Path) -> None:
    """A chain longer than the limit is refused; one of exactly the limit is not."""
    names = [f"f{i}" for i in range(10)]
    for name, following in itertools.pairwise(names):
        write(tmp_path, **{name: f'#include "{following}.glsl"\n'})
    write(tmp_path, f9="int x;\n")
    with pytest.raises(ShaderError, match="nested more than 8 deep"):
        compose("f0.glsl", {}, tmp_path)
    assert body(compose("f1.glsl", {}, tmp_path).text) == ["int x;"]


@pytest.mark.parametrize(
    "condition", ["#if HAS_NOTHING", "#if 1 && (HAS_NOTHING > 2)", "#if 0\n#elif HAS_NOTHING == 1"]
)
def test_a_tested_name_that_is_not_defined(tmp_path: Path, condition: str) -> None:
    """GLSL would take it for 0; here it is named, with file and line."""
    write(tmp_path, main='int x;\n#include "part.glsl"\n', part=f"int y;\n{condition}\n#endif\n")
    line = 2 + condition.count("\n")
    with pytest.raises(ShaderError, match=rf"^part\.glsl:{line}: HAS_NOTHING is tested but not defined"):
        compose("main.glsl", {"OTHER": 1}, tmp_path)


@pytest.mark.parametrize(
    "text", ["#if KNOWN", "#define LOCAL 1\n#if LOCAL", "#if defined(WHATEVER)", "#ifdef WHATEVER", "#if 1 // WORD"]
)
def test_names_that_may_be_tested(tmp_path: Path, text: str) -> None:
    """Given ones, ones that the shader defines, and questions whether a name is defined."""
    write(tmp_path, main=f"{text}\nint x;\n#endif\n")
    assert "int x;" in compose("main.glsl", {"KNOWN": 0}, tmp_path).text


@pytest.mark.gl
def test_a_compile_error_names_the_included_file_and_line(
    renderer: previs.Renderer, tmp_path: Path, monkeypatch
) -> None:
    """Names that file and its line, not the line of the composed text."""
    write(tmp_path, first="float one() {\n    return 1.0;\n}\n", second="\n\nfloat two() { return nonsense; }\n")
    (tmp_path / "vertex.vert").write_text(VERTEX)
    (tmp_path / "main.frag").write_text(
        'out vec4 c;\n#include "first.glsl"\n#include "second.glsl"\nvoid main() { c = vec4(one() + two()); }\n'
    )
    monkeypatch.setattr(shader, "shader_folder", lambda: tmp_path)
    with renderer.context, pytest.raises(ShaderError, match=r"second\.glsl:3\b") as error:
        Program(renderer.context, "vertex.vert", "main.frag", {})
    assert "nonsense" in str(error.value)


@pytest.mark.gl
def test_lines_after_an_include_are_counted_right(renderer: previs.Renderer, tmp_path: Path, monkeypatch) -> None:
    """An error below an include, and one in the vertex shader, name their own files and lines."""
    write(tmp_path, first="float one() {\n    return 1.0;\n}\n")
    (tmp_path / "good.vert").write_text(VERTEX)
    (tmp_path / "bad.vert").write_text("\nvoid main() { gl_Position = vec4(wrong); }\n")
    (tmp_path / "bad.frag").write_text('out vec4 c;\n#include "first.glsl"\n\nvoid main() { c = vec4(nonsense); }\n')
    (tmp_path / "good.frag").write_text("out vec4 c;\nvoid main() { c = vec4(1.0); }\n")
    monkeypatch.setattr(shader, "shader_folder", lambda: tmp_path)
    with renderer.context:
        with pytest.raises(ShaderError, match=r"bad\.frag:4\b"):
            Program(renderer.context, "good.vert", "bad.frag", {})
        with pytest.raises(ShaderError, match=r"bad\.vert:2\b"):
            Program(renderer.context, "bad.vert", "good.frag", {})


@pytest.mark.gl
def test_the_source_can_be_read(renderer: previs.Renderer, monkeypatch, capsys) -> None:
    """With PREVIS_SHADER_SOURCE=1 numbered sources go to stderr; otherwise nothing does."""
    for value in ("0", "1"):
        monkeypatch.setenv("PREVIS_SHADER_SOURCE", value)
        with renderer.context:
            Program(renderer.context, "fullscreen.vert", "composite.frag", COMPOSITE).release()
        shown = capsys.readouterr().err
        assert ("    1  #version 330 core" in shown) == (value == "1")


COMPOSITE = {"HAS_MEDIA": True, "HAS_MESHES": True, "HAS_EMISSION": True}
NOISE = smooth_noise((4, 4, 4))
GLOWING = Medium(emission=(1.0, 1.0, 1.0))
MESH = box_mesh((-0.2, -0.2, -0.2), (0.2, 0.2, 0.2))
SHINY = box_mesh((-0.2, -0.2, -0.2), (0.2, 0.2, 0.2), path="/Shiny", specular=True, emissive_color=(1.0, 0.0, 0.0))
RED = Medium(extinction=(1.0, 2.0, 3.0), phase="schlick", anisotropy=0.3)
SUN, LAMP, SPOT = distant((0, -1, 0)), point((0, 2, 0)), spot((0, 2, 0), (0, 0, 0))
RECT = spot((0, 2, 0), (0, 0, 0), kind="rect", shaped=False, path="/Rect")
CONTENTS = {
    "nothing": (),
    "mesh": (MESH,),
    "shiny mesh, sun": (SHINY, SUN),
    "fog": (box(Medium()),),
    "fog, sun": (box(Medium()), SUN),
    "fog, mesh, spot": (box(Medium()), MESH, SPOT),
    "fog, spot": (sphere(RED), SPOT),
    "fogs, lights": (box(RED), sphere(GLOWING), capsule(Medium(phase="rayleigh")), SUN, LAMP, SPOT, RECT),
    "voxels": (volume(NOISE, Medium()),),
    "voxels, sun": (volume(NOISE, Medium()), SUN),
    "voxels, lamp, mesh": (volume(NOISE, RED), LAMP, SHINY),
    "voxels and fog, lights": (volume(NOISE, RED), box(Medium()), SUN, LAMP, SPOT, RECT, MESH),
    "glowing voxels": (volume(NOISE, GLOWING, emission=NOISE),),
    "hot voxels, sun": (volume(NOISE, GLOWING, temperature=NOISE), SUN),
    "hot and glowing voxels": (volume(NOISE, GLOWING, temperature=NOISE, emission=NOISE), SPOT, MESH),
    "many voxels, lights": (
        *(volume(NOISE, RED, path=f"/V{i}") for i in range(5)),
        *(point((i, 3, 0), path=f"/P{i}") for i in range(9)),
    ),
}
SETTINGS = {
    "quantile 6": {"coefficients": 6},
    "quantile 2, weighted": {"coefficients": 2, "density_weighting": 3.0},
    "quantile 16, stochastic": {"coefficients": 16, "map_filter": "stochastic"},
    "tfm 6": {"transmittance": "tfm", "coefficients": 6},
    "tfm 14, nearest": {"transmittance": "tfm", "coefficients": 14, "map_filter": "nearest", "ambient": 0.1},
    "tfm 2, weighted": {"transmittance": "tfm", "coefficients": 2, "density_weighting": 3.0},
    "tfm 16, stochastic": {
        "transmittance": "tfm",
        "coefficients": 16,
        "density_weighting": 1.0,
        "map_filter": "stochastic",
    },
    "plain 10": {"transmittance": "tfm-plain", "coefficients": 10},
    "march": {"transmittance": "march", "projective_steps": False},
    "march, exact": {"transmittance": "march", "light_steps": 0},
}


@pytest.mark.gl
@pytest.mark.parametrize(
    ("content", "knobs"),
    [
        (content, knobs)
        for content, knobs in itertools.product(CONTENTS, SETTINGS)
        # Without maps there are no variants of maps.
        if "voxels" in content or knobs in ("quantile 6", "march")
    ],
)
def test_variants_compile_and_draw(renderer: previs.Renderer, content: str, knobs: str) -> None:
    """Every combination of a sample of scenes and knobs compiles and draws."""
    settings = Settings(**{"steps": 4, "light_steps": 4, "shadow_map_size": 16, "map_size": 8, **SETTINGS[knobs]})
    image = renderer.render(index_of(scene(*CONTENTS[content])), camera((0, 0, 6)), (4, 3), settings)
    assert image.color.min() >= 0.0


def declared_samplers(text: str) -> list[str]:
    """Names of the samplers in a composed shader, by its own defines."""
    defines, kept, names = {}, [], []

    def holds(condition: str) -> bool:
        condition = re.sub(r"[A-Z][A-Z0-9_]+", lambda m: str(defines[m[0]]), condition.split("//")[0])
        condition = re.sub(r"!(?!=)", " not ", condition)
        return bool(eval(condition.replace("&&", " and ").replace("||", " or ")))

    for line in text.splitlines():
        word, _, rest = line.strip().partition(" ")
        if word == "#if":
            taken = all(now for now, _ in kept) and holds(rest)
            kept.append((taken, taken))
        elif word in ("#elif", "#else"):
            _, taken = kept.pop()
            now = all(now for now, _ in kept) and not taken and (word == "#else" or holds(rest))
            kept.append((now, taken or now))
        elif word == "#endif":
            kept.pop()
        elif all(now for now, _ in kept):
            if word == "#define" and re.fullmatch(r"[A-Z][A-Z0-9_]+ -?\d+(\.\d+)?", rest):
                name, value = rest.split()
                defines[name] = float(value)
            elif found := re.match(r"uniform [iu]?sampler\w+ (\w+);", line):
                names.append(found[1])
    return names


def test_shaders_need_no_more_texture_units_than_all_devices_have() -> None:
    """GL 3.3 guarantees 16 to a fragment shader: none declares more, whatever it is compiled for."""
    tested = set()
    for path in shader_folder().rglob("*.*"):
        for line in path.read_text().splitlines():
            if line.startswith(("#if", "#elif")):
                tested |= set(re.findall(r"\b[A-Z][A-Z0-9_]+\b", line))
    fragments = sorted(shader_folder().glob("*.frag"))
    assert fragments
    most = dict.fromkeys(tested, 1) | {"VOLUME_COUNT": 2, "LIGHT_CAPACITY": 64}
    methods = [
        METHODS[name].defines(Settings(transmittance=name, coefficients=BY_NAME["coefficients"].maximum))
        for name in METHODS
    ]
    counts = {}
    for path in fragments:
        for method, resumes, pixels in itertools.product(methods, (0, 1), (0, 1)):
            defines = most | method | {"RESUMES": resumes, "SCATTERED_PIXELS": pixels}
            names = declared_samplers(compose(path.name, defines).text)
            assert len(names) <= 16, (path.name, names)
            counts[path.name] = max(counts.get(path.name, 0), len(names))
    assert counts["march.frag"] > 12
