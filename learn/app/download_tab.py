"""Tab 3 of the page: the files of an edit at the photograph's size, and the command for it."""

from collections.abc import Iterator
from typing import Any

from learn.app.event_handling import QUIET, SessionOf, one_line
from learn.app.offline_gradio import gr
from manifests.wording import number_of


class DownloadTab:
    """Lays the tab out when it is made, inside gr.Tabs; `connect` then says what its button does.

    outputs  files, command and a line about them; EMPTY: their values for another photograph
    """

    EMPTY = (None, "", "")

    def __init__(self, session_of: SessionOf):
        self.session_of = session_of
        with gr.Tab("3  Download", id="download"):
            gr.Markdown(
                "The edit at the photograph's size, rendered without shortcuts. This takes some"
                " seconds."
            )
            self.make = gr.Button("Make the files", variant="primary", elem_id="make")
            made = gr.Markdown(elem_id="made")
            downloads = gr.File(
                label="Files", file_count="multiple", interactive=False, elem_id="downloads"
            )
            command = gr.Textbox(
                label="The command that repeats it, in a folder with these files and the"
                " photograph",
                interactive=False,
                buttons=["copy"],
                elem_id="command",
            )
        self.outputs = [downloads, command, made]

    def connect(self) -> None:
        """Connect the button."""
        self.make.click(self.write_all, None, self.outputs, **QUIET)

    @one_line
    def write_all(self, request: gr.Request) -> Iterator[tuple[Any, ...]]:
        """Write the files."""
        session = self.session_of(request)
        session.decomposed()
        yield gr.skip(), gr.skip(), "Rendering at the photograph's size …"
        paths, text = session.downloads()
        yield (
            [str(path) for path in paths],
            text,
            f"{number_of(len(paths), 'file')} {'is' if len(paths) == 1 else 'are'} ready.",
        )
