"""One simulated session for all tests: photographed, and registered through the stage's files."""

from pathlib import Path

import imagecodecs
import numpy as np
import plate
import pytest
import yaml
from register_session import Session

from kinran.register import target
from kinran.register.register import main

ANGLES = ((0, 0), (25, 20), (45, 140), (60, 20), (60, 140), (60, 260))


@pytest.fixture(scope="session")
def session(tmp_path_factory: pytest.TempPathFactory) -> Session:
    """Front view and five side views to 60°, on disk."""
    rng = np.random.default_rng(7)
    layers = plate.texture(rng)
    views = [plate.view(f"t{t}p{p}" if t else "front", t, p, rng) for t, p in ANGLES]
    pictures = [plate.photograph(view, layers, rng) for view in views]
    folder = tmp_path_factory.mktemp("session")
    for view, picture in zip(views, pictures, strict=True):
        (folder / f"{view.name}.png").write_bytes(imagecodecs.png_encode(picture))
    (folder / "board.yaml").write_text(yaml.safe_dump(plate.SPEC))
    board = target.make_board(plate.SPEC)
    corners = [target.detect(board, p, v.name) for p, v in zip(pictures, views, strict=True)]
    return Session(views, pictures, layers[0], board, corners, folder)


@pytest.fixture(scope="session")
def registered(session: Session, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of the stage's results."""
    out = tmp_path_factory.mktemp("registered")
    main(session.inputs(session.files), out)
    return out
