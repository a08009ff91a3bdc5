"""Tab 3 of the page: the files of an edit at the photograph's size, and the command for it."""

from collections.abc import Iterator
from typing import Any

from learn.app import download_files
from learn.app.download_files import Downloads
from learn.app.event_handling import QUIET, SessionOf, one_line
from learn.app.offline_gradio import gr


class DownloadTab:
    """Lays the tab out when it is made, inside gr.Tabs; `connect` then says what its button does.

    outputs  files, command and a line about them; EMPTY: their values for another photograph
    """

    EMPTY = (None, None, None, "", "")

    def __init__(self, session_of: SessionOf):
        self.session_of = session_of
        with gr.Tab("3  Download", id="download"):
            gr.Markdown(
                "The picture, and all that you kept to compare, at the photograph's full size. This"
                " takes some seconds for each."
            )
            self.make = gr.Button("Make the pictures", variant="primary", elem_id="make")
            made = gr.Markdown(elem_id="made")
            pictures = files("Pictures", "pictures")
            work = files("Your work: open it in step 1 to continue later", "saved-work")
            with gr.Accordion("For programs: linear radiance, materials, mask", open=False):
                others = files("Files", "downloads")
                command = gr.Textbox(
                    label="The command that repeats the edit, in a folder with these files and the"
                    " photograph",
                    interactive=False,
                    buttons=["copy"],
                    elem_id="command",
                )
        self.outputs: list[Any] = [pictures, work, others, command, made]

    def connect(self) -> None:
        """Connect the button."""
        self.make.click(self.write_all, None, self.outputs, **QUIET)

    @one_line
    def write_all(self, request: gr.Request) -> Iterator[tuple[Any, ...]]:
        """Write the files."""
        session = self.session_of(request)
        opened = session.photograph
        nothing = (gr.skip(),) * (len(self.outputs) - 1)
        steps = download_files.write(session)
        while True:
            try:
                yield (*nothing, next(steps))
            except StopIteration as ended:
                made: Downloads = ended.value
                break
            if session.photograph is not opened:  # whose files these would be no more
                return
        if session.photograph is not opened:
            return
        count = len(made.pictures)
        said = "The picture is ready." if count == 1 else f"{count} pictures are ready."
        yield (
            [str(path) for path in made.pictures],
            str(made.work),
            [str(path) for path in made.others],
            made.command,
            f"{said} Click on a size to download a file.",
        )


def files(label: str, name: str) -> gr.File:
    """Return a list of files to download; name: its element's id."""
    return gr.File(label=label, file_count="multiple", interactive=False, elem_id=name)
