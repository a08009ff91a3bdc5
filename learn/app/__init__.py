"""The page to edit photographs in, `brdfactory app`.

What needs gradio: page, its three tabs (object_tab, material_tab with material_layout,
download_tab), edit_view, edit_controls, event_handling and offline_gradio.
"""
