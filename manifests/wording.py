"""Numbers of things in messages: "1 picture" and "2 pictures"."""


def number_of(count: int, singular: str, plural: str | None = None, form: str = "") -> str:
    """Return a number with its noun.

    plural  None: the singular and an s
    form    of the number, as `format` takes it; "," separates thousands
    """
    noun = singular if count == 1 else plural or f"{singular}s"
    return f"{count:{form}} {noun}"
