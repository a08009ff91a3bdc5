"""The page to edit photographs in, `brdfactory app`.

What needs gradio: page, its three tabs (object_tab, material_tab, download_tab), event_handling and
offline_gradio.
"""
