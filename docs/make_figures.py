"""Draws the figures of docs/model.md and the pictures of the tutorials into docs/images: `python docs/make_figures.py`.

It needs Matplotlib. What is plotted comes from the evaluator, in colours that are read on light and on dark pages; the
pictures are what the tutorials' own commands draw.
"""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from PIL import Image

from mrm_nodes import cli
from mrm_nodes import reference as ref
from mrm_nodes.files import write_bytes
from mrm_nodes.plotfile import figure_bytes
from mrm_nodes.reference.polar import profile

FOLDER = Path(__file__).parent / "images"
INK, BLUE, ORANGE, GREEN = "#7d7d7d", "#3f8fd0", "#d9772b", "#3f9c55"
STYLE = {
    "svg.fonttype": "none",
    "font.family": "sans-serif",
    "font.size": 11,
    "savefig.transparent": True,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "axes.titlecolor": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "legend.frameon": False,
    "lines.linewidth": 1.8,
}


def axes_of(width: float = 6.4, height: float = 3.2) -> tuple[Figure, Any]:
    figure = Figure(figsize=(width, height), layout="constrained")
    return figure, figure.add_subplot()


def views(degrees: np.ndarray) -> np.ndarray:
    """Directions in the plane of tangent and normal, (n, 3)."""
    angle = np.radians(degrees)
    return np.stack([np.sin(angle), np.zeros_like(angle), np.cos(angle)], axis=-1)


def mirror() -> Figure:
    """v, its mirror v', a light, and the half vectors of both: all computed."""
    figure, axes = axes_of(6.4, 3.4)
    v, l = views(np.array([50.0, 30.0]))  # noqa: E741
    back = v * [-1.0, 1.0, 1.0]
    half, b = v + l, back + l
    arrows = (
        (v, "v", BLUE, "-"),
        (back, "v′ = 2(n·v)n − v", BLUE, "--"),
        (l, "l", ORANGE, "-"),
        (half / np.linalg.norm(half), "h", INK, ":"),
        (b / np.linalg.norm(b), "b, half of v′ and l", GREEN, "-"),
        (np.array([0.0, 0.0, 1.0]), "", INK, "-"),
    )
    axes.plot([-1.5, 1.5], [0.0, 0.0], color=INK)
    axes.plot([0.0, 0.0], [0.0, 1.25], color=INK, linewidth=1.0, linestyle=(0, (6, 4)))
    for direction, name, colour, line in arrows:
        x, _, z = direction
        arrow = {"arrowstyle": "->", "color": colour, "linestyle": line, "linewidth": 1.8}
        axes.annotate("", (x, z), (0.0, 0.0), arrowprops=arrow)
        side = "right" if x < -0.02 else "left" if x > 0.02 else "center"
        axes.text(1.06 * x, 1.06 * z + 0.02, name, color=colour, ha=side, va="bottom")
    axes.text(0.05, 1.0, "n", ha="left", va="center")
    axes.text(0.05, 1.24, "virtual mirror", ha="left", va="top")
    axes.set(xlim=(-1.6, 1.6), ylim=(-0.05, 1.32), aspect="equal")
    axes.axis("off")
    return figure


def lobes() -> Figure:
    """A white lobe of alpha 0.3 seen at 45 degrees: forward, turned, and half of each."""
    figure = Figure(figsize=(6.4, 3.6), layout="constrained")
    axes: Any = figure.add_subplot(projection="polar")
    for weight, colour, line in ((0.0, BLUE, "-"), (1.0, GREEN, "-"), (0.5, ORANGE, "--")):
        lobe = ref.GeneralizedSchlick(1.0, alpha=0.3, retroreflectivity=weight)
        angles, values = profile(lobe, 45.0)
        above = np.abs(angles) <= np.pi / 2
        axes.plot(angles[above], values[above], color=colour, linestyle=line, label=f"weight {weight:g}")
    axes.annotate("v", (np.pi / 4, 1.9), color=INK, ha="center", va="center")
    axes.plot([np.pi / 4] * 2, [0.0, 1.8], color=INK, linewidth=1.0, linestyle=":")
    axes.set_theta_zero_location("N")
    axes.set_theta_direction(-1)
    axes.set(thetamin=-90, thetamax=90, ylim=(0.0, 2.0), rticks=[1.0, 2.0])
    axes.grid(color=INK, linewidth=0.4)
    axes.legend(loc="upper left", bbox_to_anchor=(0.98, 0.95))
    return figure


def distributions() -> Figure:
    figure, axes = axes_of()
    slope = np.linspace(0.0, 4.0, 120)
    alpha = 0.2
    normals = views(np.degrees(np.arctan(slope * alpha)))
    for name, made, colour in (
        ("GGX", ref.GGX, BLUE),
        ("Beckmann", ref.Beckmann, ORANGE),
        ("Phong", ref.Phong, GREEN),
    ):
        values = made(alpha).D(normals)
        axes.semilogy(slope, values / values[0], color=colour, label=name)
    axes.set(xlabel="slope of the normal, tan θ / α, for α = 0.2", ylabel="D(m) / D(n)", ylim=(1e-6, 1.5))
    axes.legend()
    return figure


def masking() -> Figure:
    figure, axes = axes_of()
    degrees = np.linspace(0.0, 89.9, 180)
    w, n = views(degrees), np.array([0.0, 0.0, 1.0])
    for name, made, colour in (
        ("GGX", ref.GGX, BLUE),
        ("Beckmann", ref.Beckmann, ORANGE),
        ("Phong", ref.Phong, GREEN),
    ):
        axes.plot(degrees, made(0.5).G1(w, n), color=colour, label=f"Smith, {name}")
    towards = views(np.array(30.0))
    axes.plot(
        degrees,
        ref.GGX(0.5).G1(w, towards, "vcavity"),
        color=INK,
        linestyle="--",
        label="V-cavity, m 30° towards it",
    )
    axes.set(
        xlabel="angle of the direction from the normal, degrees; α = 0.5",
        ylabel="G₁",
        xlim=(0, 90),
        ylim=(0, 1.03),
    )
    axes.legend(loc="lower left")
    return figure


def fresnel() -> Figure:
    figure, axes = axes_of()
    degrees = np.linspace(0.0, 90.0, 181)
    cosine = np.cos(np.radians(degrees)).clip(0.0, 1.0)
    axes.plot(degrees, ref.fresnel_conductor(cosine, 0.2, 3.9), color=BLUE, label="conductor, 0.2 + 3.9 i")
    axes.plot(degrees, ref.fresnel_dielectric(cosine, 1.5), color=ORANGE, label="dielectric, 1.5")
    axes.plot(degrees, ref.fresnel_schlick(cosine, 0.19), color=GREEN, label="Schlick, F₀ 0.19")
    tinted = ref.fresnel_schlick(cosine, 0.19, 0.0)
    axes.plot(degrees, tinted, color=GREEN, linestyle="--", label="the same, F₈₂ 0: the paper's tape")
    axes.set(xlabel="angle to the microfacet's normal, degrees", ylabel="F", xlim=(0, 90), ylim=(0, 1.03))
    axes.legend(loc="upper left", bbox_to_anchor=(0.0, 0.92))
    return figure


def compensation() -> Figure:
    figure, axes = axes_of()
    degrees = np.linspace(0.0, 88.0, 45)
    view = views(degrees)
    for alpha, colour in ((0.25, BLUE), (0.5, ORANGE), (1.0, GREEN)):
        bare = ref.GeneralizedSchlick(1.0, alpha=alpha).albedo(view)[:, 0]
        axes.plot(degrees, bare, color=colour, label=f"α = {alpha:g}")
        whole = ref.GeneralizedSchlick(1.0, alpha=alpha, energy_compensation="kulla-conty").albedo(view)[:, 0]
        axes.plot(degrees, whole, color=colour, linestyle="--")
    axes.set(
        xlabel="angle of the view, degrees; dashed: with Kulla and Conty's term",
        ylabel="albedo of a white lobe",
    )
    axes.set(xlim=(0, 90), ylim=(0.3, 1.03))
    axes.legend(loc="lower left")
    return figure


def layering() -> Figure:
    """What a base has below a coat, by MaterialX's rule and by the coat's own albedo."""
    figure, axes = axes_of()
    degrees = np.linspace(0.0, 89.0, 90)
    view = views(degrees)
    for name, coat, colour in (
        ("the yellow tape's beads: F₀ 0.19, F₈₂ 0", ref.GeneralizedSchlick(0.19, 0.0, alpha=0.0529), ORANGE),
        (
            "a film of 350 nm on glass",
            ref.Dielectric(1.5, 0.09, thinfilm_thickness=350.0, thinfilm_ior=2.2),
            GREEN,
        ),
        ("glass, roughness 0.3", ref.Dielectric(1.5, 0.09), BLUE),
    ):
        # Green, where a film has a colour.
        leaf = ref.Leaf(coat)
        axes.plot(degrees, leaf.exact_throughput(view)[:, 1], color=colour, label=name)
        axes.plot(degrees, leaf.throughput(view)[:, 1], color=colour, linestyle="--")
    axes.set(
        xlabel="angle of the view, degrees; dashed: by MaterialX's rule",
        ylabel="what the base keeps",
        xlim=(0, 90),
        ylim=(0.0, 1.03),
    )
    axes.legend(loc="lower left")
    return figure


FIGURES: dict[str, Callable[[], Figure]] = {
    "model-mirror": mirror,
    "model-lobes": lobes,
    "model-distributions": distributions,
    "model-masking": masking,
    "model-fresnel": fresnel,
    "model-compensation": compensation,
    "model-layering": layering,
}


def tutorial_cone(folder: Path) -> Image.Image:
    """Step 2 of the artist's: the frames of a light sweep."""
    command(
        "render",
        "traffic_cone",
        "--mesh",
        "baluster",
        "--light-sweep",
        "6",
        "--size",
        "200x320",
        folder / "cone.png",
    )
    return side_by_side([Image.open(folder / f"cone.0{number}.png") for number in range(1, 7)])


def tutorial_stripes(folder: Path) -> Image.Image:
    """Step 4 of the artist's: a torch at the camera, and a room."""
    page = (FOLDER.parent / "tutorials/artist.md").read_text("utf-8")
    document = folder / "striped.mtlx"
    document.write_text(page.split("<!-- striped.mtlx -->")[1].split("```")[0], "utf-8")
    command("render", document, "--size", "320", folder / "torch.png")
    command("render", document, "--size", "320", "--env", "studio", folder / "room.png")
    return side_by_side([Image.open(folder / name) for name in ("torch.png", "room.png")])


def command(*arguments: Any) -> None:
    """Run `mrm-nodes`, the last argument being its output."""
    *words, output = map(str, arguments)
    try:
        cli.main([*words, "-o", output])
    except SystemExit as ended:
        if ended.code:
            raise


def side_by_side(pictures: list[Image.Image]) -> Image.Image:
    """On the dark grey that a night is read on."""
    size = sum(each.width for each in pictures), max(each.height for each in pictures)
    sheet = Image.new("RGBA", size, (24, 24, 26, 255))
    left = 0
    for each in pictures:
        sheet.alpha_composite(each.convert("RGBA"), (left, 0))
        left += each.width
    return sheet.convert("RGB")


PICTURES: dict[str, Callable[[Path], Image.Image]] = {
    "tutorial-cone": tutorial_cone,
    "tutorial-stripes": tutorial_stripes,
}

if __name__ == "__main__":
    for name, render in PICTURES.items():
        path = FOLDER / f"{name}.webp"
        with TemporaryDirectory() as folder:
            drawn = io.BytesIO()
            render(Path(folder)).save(drawn, "WEBP", quality=90)
            write_bytes(path, drawn.getvalue())
        print(path)
    for name, draw in FIGURES.items():
        path = FOLDER / f"{name}.svg"
        with matplotlib.rc_context(STYLE):
            write_bytes(path, figure_bytes(draw(), path))
        print(path)
