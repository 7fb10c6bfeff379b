"""Reconstructions made by hand, and pages read as a browser reads them."""

from html.parser import HTMLParser

import cv2
import numpy as np

import tisfm
from tisfm.reconstruction.result.folder import write_depth
from tisfm.status import Status

EVIL = "<script>alert(1)</script>\"'&"


def reconstruction(folder, *, pieces, shape=(30, 44), statuses=None, names=None, skipped=()):
    """Return a reconstruction whose frames are of these pieces, in a folder of its own.

    A frame of the piece -1 has no pose; frames with a pose have depth.
    """
    (folder / "depth").mkdir(parents=True)
    (folder / "frames").mkdir()
    height, width = shape
    random = np.random.default_rng(0)
    count = len(pieces)
    poses = np.full((count, 4, 4), np.nan)
    for k, piece in enumerate(pieces):
        picture = random.integers(0, 256, (height, width, 3), np.uint8)
        cv2.imwrite(str(folder / "frames" / f"{k:06d}.jpg"), picture)
        if piece >= 0:
            poses[k] = np.eye(4)
            poses[k, :3, 3] = 0.1 * k, 0.01 * k, 0.05 * k
            inverse = np.linspace(0.2, 1.5, height * width, dtype=np.float32).reshape(shape)
            inverse[:2] = np.nan
            write_depth(folder, k, inverse, np.where(np.isnan(inverse), np.inf, 0.02 * inverse))
    given = statuses or [
        Status("converged") if piece >= 0 else Status("no_texture", "it shows too little: film on")
        for piece in pieces
    ]
    return tisfm.Reconstruction(
        poses=poses,
        piece=np.array(pieces, np.int32),
        unit=(1.0,) * (max(pieces) + 1),
        position_deviation=np.where(np.array(pieces)[:, None] >= 0, [[1e-3] * 3], np.nan),
        rotation_deviation=np.where(np.array(pieces)[:, None] >= 0, [[0.02] * 3], np.nan),
        status=tuple(given),
        depth_error=np.where(np.array(pieces) >= 0, 0.0135, np.nan),
        depth_share=np.where(np.array(pieces) >= 0, 1.0, 0.0),
        keyframes=tuple(k for k, piece in enumerate(pieces) if piece >= 0)[::3],
        camera=tisfm.Camera(focal=40.0),
        settings=tisfm.Settings.preset("fast", motion="camera"),
        names=tuple(names or [f"f{k}" for k in range(count)]),
        times=(None,) * count,
        skipped=tuple(skipped),
        shape=shape,
        folder=folder,
        version="0",
    )


class Read(HTMLParser):
    """What a page has: tags with their attributes, and texts outside of styles and scripts."""

    VOID = ("meta", "img", "input", "br", "link")

    def __init__(self, path):
        super().__init__()
        self.tags, self.texts, self.scripts, self.open = [], [], [], []
        self.feed(path.read_text(encoding="utf-8"))
        assert self.open == [], "elements are left open"

    def handle_starttag(self, tag, attributes):
        self.tags.append((tag, dict(attributes)))
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attributes):
        self.tags.append((tag, dict(attributes)))

    def handle_endtag(self, tag):
        assert self.open and self.open.pop() == tag, f"</{tag}> closes another element"

    def handle_data(self, data):
        (self.scripts if self.open[-1:] in (["script"], ["style"]) else self.texts).append(data)

    @property
    def text(self):
        return " ".join(" ".join(self.texts).split())

    def all(self, tag, **attributes):
        """Return the attributes of elements of this tag that have those given."""
        return [
            found
            for name, found in self.tags
            if name == tag and all(found.get(k.strip("_")) == v for k, v in attributes.items())
        ]


def assert_self_contained(page):
    """Check that a page asks for nothing outside of it, and runs no script but its own."""
    for tag, attributes in page.tags:
        assert tag not in ("link", "iframe", "object", "embed", "base", "form"), tag
        for name, value in attributes.items():
            assert not name.startswith("on"), (tag, name)
            if name in ("src", "href", "xlink:href", "action", "srcset"):
                assert value.startswith(("data:image/", "#")), (tag, name, value[:60])
            elif name == "style":
                assert "http" not in value, value
    assert len(page.all("script")) == 1
    for content in page.scripts:
        assert "http" not in content and "@import" not in content
        assert "url(" not in content.replace("url(#", "")
