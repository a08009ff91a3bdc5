"""The page to edit photographs in, `brdfactory app`. Only learn.app.page needs gradio."""
