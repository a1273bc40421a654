"""The site builds with every link and anchor checked, and has what it promises."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from support import list_gallery, load_part_types

import kc2spice as kc

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    out = tmp_path_factory.mktemp("site")
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "-d", str(out)],
        cwd=ROOT, capture_output=True, text=True, check=False,
        env={**os.environ, "PYTHONPATH": str(ROOT), "NO_MKDOCS_2_WARNING": "1"},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return out


def page(site, name):
    return (site / name / "index.html").read_text(encoding="utf-8")


@pytest.mark.slow
def test_every_public_name_is_on_the_api_page(site):
    text = page(site, "reference/python_api")
    for name in {getattr(kc, name).__name__ for name in set(kc.__all__) - {"errors", "Section"}}:
        assert re.search(rf'id="kc2spice\.[\w.]*\.{name}"', text), name


@pytest.mark.slow
def test_every_part_scene_and_example_is_shown(site):
    parts, scenes, examples = (page(site, name) for name in ("parts", "scenes", "examples"))
    assert all(f'id="{name}"' in parts for name, kind in load_part_types().items()
               if kind.__module__.startswith("kc2spice."))  # fmt: skip
    assert all(f"<code>{name}</code>" in scenes for name in list_gallery())
    for path in (ROOT / "docs" / "examples").glob("*.py"):
        assert path.name in examples


@pytest.mark.slow
def test_site_loads_nothing_from_elsewhere(site):
    loads = re.compile(r'<(?:script|link|img)[^>]*(?:src|href)="(https?:[^"]+)')
    for path in site.rglob("*.html"):
        found = loads.findall(path.read_text(encoding="utf-8"))
        assert [url for url in found if "canonical" not in url] == [], path


def test_links_of_the_pages_outside_of_the_site_lead_somewhere():
    for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md"):
        for target in re.findall(r"\]\(([^)]+)\)", (ROOT / name).read_text(encoding="utf-8")):
            if not target.startswith("http"):
                assert (ROOT / target.split("#")[0]).exists(), f"{name}: {target}"
