"""`snakemake --report`: a page that shows all fabrics, without a network."""

import re
from pathlib import Path

from conftest import ROOT, Project

CAPTIONS = ROOT / "workflow" / "report"


def test_each_fabric_and_each_picture_has_its_caption(finished: Project, tmp_path: Path) -> None:
    page = tmp_path / "report.html"
    finished.run("--report", str(page))
    text = page.read_text()
    assert re.search(r"<em>Kinran</em>|<cite>Kinran</cite>", text)
    for name in ("All fabrics", "Fabric tiny", "the light moved", "held-out lights", "uncertainty"):
        assert f'"{name}"' in text, name
    for caption in ("report", "render", "sweep", "evaluation", "sigma"):
        words = (CAPTIONS / f"{caption}.rst").read_text().split("{{")[0].replace("**", "<strong>").split()
        assert " ".join(words) + "tiny</strong>" in " ".join(text.replace("\\n", " ").split()), caption
    assert "Errors of the lobes" not in text  # nobody chose
    assert not re.search(r"<(script|link)[^>]+(src|href)=.https?:", text)


def test_each_caption_is_one_of_an_output() -> None:
    rules = "".join(path.read_text() for path in (ROOT / "workflow" / "rules").glob("*.smk"))
    shown = {Path(path).stem.split(".")[-1] for path in re.findall(r'shown\("([^"]+)"', rules)}
    assert shown | {"overview", "workflow"} == {path.stem for path in CAPTIONS.glob("*.rst")}
