"""How the page looks: colours, fonts, and rules for narrow, dark and high-contrast screens.

Texts have a contrast of 4.5 to 1 or more, as WCAG 2.2 asks at level AA.
"""

from learn.app.offline_gradio import gr

CSS = """
:root {--block-info-text-color: #595959; --body-text-color-subdued: #595959;
  --input-placeholder-color: #595959}
.dark {--block-info-text-color: #b4b4b4; --body-text-color-subdued: #b4b4b4;
  --input-placeholder-color: #b4b4b4}
.gradio-container {max-width: 1240px !important; width: 100%; margin: auto !important;
  overflow: clip !important}
.gradio-container main {width: 100%; max-width: 100% !important}
#title {display: flex; flex-wrap: wrap; gap: 2px 16px; align-items: baseline}
#title h1 {font-size: 1.4em; margin: 0}
#title p {margin: 0}
[role=tab][aria-selected=true] {color: var(--link-text-color) !important; font-weight: 600}
:is(button, a, input, textarea, [role=tab], [tabindex]):focus-visible {
  outline: 3px solid var(--color-accent) !important; outline-offset: 2px}
label:has(input[type=radio]:focus-visible) {
  outline: 3px solid var(--color-accent); outline-offset: 2px}
#marking button {cursor: crosshair}
#marking button:focus-visible {outline-offset: -3px}
#marking {position: relative}
/* what is done with a photograph is shown once there is one */
#step-1:not(:has(#marking img)) :is(#marked, #undoing, #fit, #shape, #own-mask, #decompose),
  #step-1:not(:has(#marking img)) .form {display: none}
#step-1:has(#marking img) #photo:not(:hover) {background: var(--button-secondary-background-fill);
  color: var(--button-secondary-text-color)}
/* as long as it is empty; screen readers have to know of it before it says anything */
:is(#progress, #improving, #kept):has(.html-container > :empty) {position: absolute; height: 0}
#marking:not(:has(img))::after {content: 'Drop a photograph here'; position: absolute; inset: 0;
  display: grid; place-items: end center; padding-bottom: 25%; pointer-events: none;
  color: var(--body-text-color-subdued)}
.dropping #marking {outline: 3px dashed var(--color-accent); outline-offset: -6px}
#materials .tiles {display: grid; grid-template-columns: repeat(auto-fill, minmax(84px, 1fr));
  gap: 4px; max-height: 300px; overflow-y: auto; contain: content}
#materials button {display: flex; flex-direction: column; align-items: center; padding: 2px;
  border: 2px solid transparent; border-radius: 4px; background: none; cursor: pointer}
#materials button:hover, #materials button:focus-visible {border-color: var(--color-accent)}
#materials button:focus-visible {outline-offset: -3px}
#materials .picture {width: 80px; height: 80px; border-radius: 50%; forced-color-adjust: none}
#materials .caption, #materials .note {font-size: 11px; line-height: 1.15; text-align: center;
  overflow-wrap: anywhere}
#materials .note {font-weight: normal}
#stayed, #point, #outline, .form:has(> :is(#key, #place)) {display: none}
/* where arrow keys move: white within black, so that it is seen on any photograph */
#cross {position: absolute; width: 41px; height: 41px; translate: -50% -50%; z-index: 5;
  pointer-events: none; forced-color-adjust: none;
  background: linear-gradient(#fff, #fff) center / 35px 2px no-repeat,
    linear-gradient(#fff, #fff) center / 2px 35px no-repeat,
    linear-gradient(#000, #000) center / 41px 6px no-repeat,
    linear-gradient(#000, #000) center / 6px 41px no-repeat}
#cross[hidden] {display: none}
#cross-path {position: absolute; inset: 0; width: 100%; height: 100%; z-index: 4;
  pointer-events: none; forced-color-adjust: none; fill: none; stroke-linejoin: round}
#cross-path [data-part=rim] {stroke: #000; stroke-width: 6}
#cross-path [data-part=core] {stroke: #fff; stroke-width: 2}
#cross-path [data-part=next] {stroke: #fff; stroke-width: 2; stroke-dasharray: 6}
#cross-line {min-height: 1.5em; margin: 0}
/* a message says what did not work; Gradio's own sign would cover the open photograph */
[data-testid=status-tracker]:has(.error) {display: none !important}
#kept .tiles {display: grid; grid-template-columns: repeat(auto-fill, minmax(150px, 1fr));
  gap: 8px; max-height: none}
#kept figure {margin: 0}
#kept img {width: 100%; border-radius: 4px}
#kept button {cursor: pointer; font-size: 12px; padding: 4px 8px; margin: 2px 4px 2px 0;
  border: 1px solid var(--border-color-primary); border-radius: 4px}
#kept button:has(img) {padding: 0; border: none}
#kept button[aria-pressed=true] {border-color: var(--color-accent); font-weight: bold}
#kept .caption {font-size: 12px; overflow-wrap: anywhere}
#decomposition .tiles {display: flex; flex-wrap: wrap; gap: 8px}
#decomposition figure {margin: 0; width: 110px; text-align: center}
#decomposition img {width: 110px; height: 110px; object-fit: contain}
#progress progress, #improving progress {width: 100%; height: 14px}
/* empty until the pictures are made */
:is(#pictures, #saved-work):has(.empty) {display: none}
footer {display: none !important}
@media (min-width: 641px) {
  /* pictures are as high as leaves what belongs to them on the screen */
  #guidance {align-items: center; flex-wrap: nowrap}
  #marking {height: clamp(300px, calc(100vh - 250px), 720px) !important}
  #editor img {max-height: clamp(300px, calc(100vh - 230px), 720px) !important;
    object-fit: contain}
  #materials .tiles {max-height: clamp(230px, calc(100vh - 390px), 560px)}
}
@media (max-width: 640px) {
  /* the picture comes after the buttons that choose it, and before what is done with it */
  .main {padding: 8px !important}
  .tab-container button {padding-inline: 8px !important}
  #step-1, #step-2 {flex-direction: column; flex-wrap: nowrap}
  #step-1 > .column, #step-2 > .column {display: contents}
  #step-1 > .column > * {order: 7}
  #photo, #example, #work {order: 1 !important}
  #guidance {display: contents}
  #status {order: 2 !important}
  #marked {order: 3 !important}
  #picture {order: 4 !important; flex-shrink: 0}
  #undoing {order: 5 !important}
  #decompose, #progress, #stop {order: 6 !important}
  #marking, #marking img {height: auto !important; max-height: 46vh}
  #marking:not(:has(img)) {display: none}
  #brush {max-height: none !important}
  #step-2 > .column > * {order: 3}
  #editor, #shown {order: 1 !important}
  #editor img {max-height: 40vh; object-fit: contain}
}
@media (max-width: 640px) and (min-height: 600px) {
  /* above the labels of sliders, which Gradio lifts; on a low screen nothing else would be seen */
  #editor {position: sticky; top: 0; z-index: 100; background: var(--body-background-fill)}
}
@media (forced-colors: active) {
  /* the screen's own colours leave out backgrounds, by which Gradio shows what is chosen */
  button, [role=tab] {border: 1px solid ButtonBorder !important}
  button:disabled {color: GrayText; border-color: GrayText !important}
  [role=tab][aria-selected=true], #kept button[aria-pressed=true] {
    forced-color-adjust: none; color: HighlightText !important; background: Highlight !important}
  input[type=radio], input[type=checkbox], input[type=range] {appearance: auto !important;
    accent-color: Highlight}
  label:has(input:checked) {border: 2px solid Highlight !important}
}
"""


def theme() -> gr.themes.Base:
    """Return the page's colours and fonts; white on a button has a contrast of 5 to 1 or more."""
    fonts, of_code = ["system-ui", "sans-serif"], ["ui-monospace", "monospace"]
    return gr.themes.Default(primary_hue="blue", font=fonts, font_mono=of_code).set(
        button_primary_background_fill="*primary_600",
        button_primary_background_fill_hover="*primary_700",
        button_primary_background_fill_dark="*primary_700",
        button_cancel_background_fill="*neutral_600",
        button_cancel_background_fill_hover="*neutral_700",
    )
