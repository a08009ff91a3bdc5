"""What tab 2 of the page consists of: the view of the edit, and the controls beside it."""

from pathlib import Path
from typing import Any

from learn.app import choices, gallery
from learn.app.choices import OWN_LIGHT
from learn.app.edit_controls import FIRST, SECOND, region_choices
from learn.app.offline_gradio import gr
from learn.app.page_html import address_of
from learn.editing import DETAIL, MOST_STOPS

SLIDERS = (  # of a material of one's own: id, label, first value
    ("roughness", "Roughness", 0.35),
    ("metallic", "Metallic", 0.0),
    ("specular", "Specular (0.5 is common)", 0.5),
    ("sheen", "Sheen, as of cloth", 0.0),
    ("coat", "Coat of clear lacquer", 0.0),
)
TILE_CLICKS = """
element.addEventListener('click', event => {
  const tile = event.target.closest('button');
  if (tile) trigger('click', {...tile.dataset, at: Date.now()});
});
"""
# The Tab key stops once at all tiles, and arrow keys go from one to the next.
TILE_KEYS = """
const isIn = {ArrowRight: 1, ArrowLeft: -1, ArrowDown: 0, ArrowUp: 0, Home: 0, End: 0};
element.addEventListener('keydown', event => {
  if (!(event.key in isIn)) return;
  const tiles = [...element.querySelectorAll('button')], at = tiles.indexOf(event.target);
  if (at < 0) return;
  event.preventDefault();
  const across = tiles.filter(each => each.offsetTop === tiles[0].offsetTop).length;
  const steps = {...isIn, ArrowDown: across, ArrowUp: -across};
  const to = {Home: 0, End: tiles.length - 1}[event.key] ?? at + steps[event.key];
  if (!tiles[to]) return;
  event.target.tabIndex = -1;
  tiles[to].tabIndex = 0;
  tiles[to].focus();
});
"""
NOTHING_YET = "Choose a photograph first, in step 1, and click on its object."


class MaterialLayout:
    """Lays the tab out when it is made, inside gr.Tabs.

    pictures  the file of the materials' pictures, where the page's server has it
    view      the edit, and a line about it
    views     these, the decomposition's parts, the kept pictures, and how far improving is
    controls  those that show light, mix and brightness of the edit
    filled    all components that a decomposition gives new values
    """

    def __init__(self, pictures: Path):
        self.pictures = pictures
        with gr.Tab("2  Material", id="edit"), gr.Row(elem_id="step-2"):
            with gr.Column(scale=3, min_width=320):
                self.slider = gr.ImageSlider(
                    show_label=False,
                    interactive=False,
                    buttons=["fullscreen"],
                    elem_id="editor",
                    type="filepath",
                    slider_position=50,
                    max_height=560,
                )
                shown = gr.Markdown(NOTHING_YET, elem_id="shown")
                with gr.Row():
                    self.keep = gr.Button(
                        "Keep this picture to compare", elem_id="keep-it", size="sm"
                    )
                    self.improve = gr.Button(
                        "Improve shape and light", elem_id="improve", size="sm"
                    )
                    self.halt = gr.Button(
                        "Stop improving", elem_id="stop-improving", size="sm", visible=False
                    )
                self.improving = gr.HTML("", elem_id="improving")
                self.kept_row = gr.HTML("", js_on_load=TILE_CLICKS, elem_id="kept")
                with gr.Accordion("What was read from the photograph", open=False):
                    parts = gr.HTML(elem_id="decomposition")
            with gr.Column(scale=2, min_width=320):
                self._lay_out_gallery()
                self._lay_out_own_materials()
                self._lay_out_light()
        self.view = [self.slider, shown]
        self.views: list[Any] = [*self.view, parts, self.kept_row, self.improving]
        self.controls: list[Any] = [
            self.share,
            self.rotation,
            self.light,
            self.hide,
            self.brightness,
            self.detail,
        ]
        self.filled: list[Any] = [*self.views, self.region, *self.controls]

    def _lay_out_gallery(self) -> None:
        self.region = gr.Radio(
            region_choices(1), value=1, label="Part of the object", elem_id="region", visible=False
        )
        self.words = gr.Textbox(
            placeholder="Search: wood, leather, gold, red plastic …",
            label="Search materials",
            show_label=False,
            elem_id="words",
        )
        self.count = gr.Markdown(f"{len(gallery.search(''))} materials", elem_id="count")
        self.materials = gr.HTML(
            self.tiles(gallery.search("")), js_on_load=TILE_CLICKS + TILE_KEYS, elem_id="materials"
        )
        self.slot = gr.Radio(
            [FIRST, SECOND], value=FIRST, label="What I choose is …", elem_id="slot"
        )
        self.share = gr.Slider(
            0,
            100,
            0,
            step=1,
            label="Mix: per cent of the second material",
            elem_id="share",
            buttons=[],
        )
        self.back = gr.Button("As in the photograph", elem_id="keep", size="sm")

    def tiles(self, names: list[str], text: str = "") -> str:
        """Return HTML with the named materials, as a search for a text has them."""
        return gallery.page_tiles(names, address_of(self.pictures), text)

    def _lay_out_own_materials(self) -> None:
        with gr.Accordion("A material of your own", open=False, elem_id="own"):
            self.color = gr.ColorPicker("#a03020", label="Colour", elem_id="color")
            self.numbers = [
                gr.Slider(0, 1, value, step=0.01, label=label, buttons=[], elem_id=key)
                for key, label, value in SLIDERS
            ]
        with gr.Accordion("The material of another picture", open=False):
            gr.Markdown(
                "A picture of an object before a transparent background, or a material.json. One"
                " of several regions gives each region its own."
            )
            self.other = gr.UploadButton(
                "Choose a picture or material.json", elem_id="other", size="sm"
            )

    def _lay_out_light(self) -> None:
        with gr.Accordion("Light", open=True):
            self.light = gr.Dropdown(
                [OWN_LIGHT, *choices.light_names()],
                value=OWN_LIGHT,
                label="Light",
                elem_id="light",
            )
            self.light_file = gr.UploadButton(
                "Or a map of your own (.exr)", elem_id="light-file", size="sm"
            )
            self.rotation = gr.Slider(
                -180,
                180,
                0,
                step=1,
                label="Turned by degrees",
                elem_id="rotation",
                buttons=[],
            )
            self.brightness = gr.Slider(
                -MOST_STOPS,
                MOST_STOPS,
                0,
                step=0.1,
                label="Brightness of the new material",
                info="How bright it is can only be guessed. +1 doubles it, −1 halves it.",
                elem_id="brightness",
                buttons=[],
            )
            self.detail = gr.Slider(
                0,
                100,
                100 * DETAIL,
                step=5,
                label="The photograph’s own shading: per cent kept",
                info=(
                    "Shadows in gaps, folds and texture, under the photograph’s own light. 0 if a"
                    " print shows through."
                ),
                elem_id="detail",
                buttons=[],
            )
            self.hide = gr.Checkbox(False, label="Hide the background", elem_id="hide")
