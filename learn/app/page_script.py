"""What the page does in the browser, beside what Gradio does."""

from learn.app.object_tab import PHOTO_BUTTON, WORK_BUTTON
from learn.app.session import MOST_BYTES

# - asks before a page with a photograph is left, since it cannot be brought back, and tells the
#   server if the user stays (a timer runs only then)
# - asks before kept pictures give way to another photograph
# - takes a photograph that is dropped on the page or pasted, where a browser would show the file in
#   place of the page
# - moves the line between the photograph and its edit with arrow keys
# - says aloud what changes; names pictures and what is drawn on
# - remembers which tab is open, and whether the photograph is being analysed, for the page that is
#   loaded again
SCRIPT = """
() => {
  const find = selector => document.querySelector(selector);
  const isOpen = step => find(step)?.checkVisibility();
  addEventListener('beforeunload', event => {
    if (!find('#marking img')) return;
    event.preventDefault();
    setTimeout(() => find('#stayed').click(), 500);
  });

  const mayReplace = () => !find('#kept figure') ||
    confirm('The pictures that you kept to compare belong to the photograph that is open. They '
      + 'are lost if you open another one. Open another one?');
  addEventListener('click', event => {
    if (event.isTrusted && event.target.closest('#photo, #example, #work') && !mayReplace()) {
      event.preventDefault();
      event.stopImmediatePropagation();
    }
  }, true);

  const give = files => {
    if (!files.length || !isOpen('#step-1') || !mayReplace()) return;
    const button = /\\.zip$/i.test(files[0].name) ? 'WORK' : 'PHOTO';
    const input = find(`input[data-testid="${button}-upload-button"]`);
    const one = new DataTransfer();
    one.items.add(files[0]);
    input.files = one.files;
    input.dispatchEvent(new Event('change', {bubbles: true}));
  };
  const holdsFiles = event => event.dataTransfer?.types.includes('Files');
  const mark = on => document.body.classList.toggle('dropping', on);
  addEventListener('dragover', event => {
    if (!holdsFiles(event)) return;
    event.preventDefault();
    mark(true);
  });
  addEventListener('dragleave', event => { if (!event.relatedTarget) mark(false); });
  addEventListener('drop', event => {
    if (!holdsFiles(event)) return;
    event.preventDefault();
    mark(false);
    give(event.dataTransfer.files);
  });
  addEventListener('paste', event => give(event.clipboardData?.files ?? []));

  addEventListener('click', event => {
    const tab = event.target.closest('[role=tab]');
    if (tab && /^\\d/.test(tab.innerText))
      try { sessionStorage.setItem('brdfactory-tab', tab.innerText[0]); } catch {}
  });

  // Gradio moves the line between photograph and edit with the mouse alone
  const place = handle => {
    const [one, all] = [handle, find('#editor img')].map(e => e.getBoundingClientRect());
    return [one.left + one.width / 2, one.top + one.height / 2, all];
  };
  const say = handle => {
    const [x, , all] = place(handle);
    // nothing has a size while the tab is closed
    handle.ariaValueNow = all.width ? Math.round(100 * (x - all.left) / all.width) : 50;
  };
  addEventListener('keydown', event => {
    const handle = event.target, step = {ArrowLeft: -1, ArrowRight: 1}[event.key];
    if (!step || !handle.matches('#editor .outer')) return;
    event.preventDefault();
    const [x, y, all] = place(handle);
    const to = Math.min(all.right - 1, Math.max(all.left + 1, x + step * all.width / 20));
    [['mousedown', x, handle], ['mousemove', to, window], ['mouseup', to, window]].forEach(
      ([name, clientX, target]) => target.dispatchEvent(
        new MouseEvent(name, {clientX, clientY: y, bubbles: true, view: window})));
    setTimeout(() => say(handle), 100);
  });

  addEventListener('pagehide', () => {
    const busy = find('#stop')?.checkVisibility() ? 'yes' : 'no';
    try { sessionStorage.setItem('brdfactory-busy', busy); } catch {}
  });

  const live = '#status, #shown, #progress, #improving, #made, #count';
  const names = [
    ['#marking img', 'alt', 'The photograph. A click on it marks the object.'],
    ['#marking button:has(img)', 'ariaLabel', 'The photograph. A click on it marks the object.'],
    ['#editor img', 'alt', 'The photograph and its edit, divided by a line'],
    ['#brush canvas', 'ariaLabel', 'The photograph, to draw on'],
  ];
  const label = () => {
    document.querySelectorAll(live).forEach(e => {
      if (!e.ariaLive) e.ariaLive = 'polite';
    });
    for (const [place, name, text] of names)
      document.querySelectorAll(place).forEach(e => {
        if (e[name] !== text) e[name] = text;
      });
    const handle = find('#editor .outer');
    if (handle && !handle.hasAttribute('tabindex')) {
      handle.tabIndex = 0;
      handle.role = 'slider';
      handle.ariaLabel = 'The line between the photograph and its edit';
      say(handle);
    }
    document.querySelectorAll('.toast-title').forEach(e => {
      const title = e.firstChild;
      if (title?.data?.trim() === 'Error') title.data = 'This did not work';
    });
    document.querySelectorAll('.toast-message-text').forEach(e => {
      if (/exceed the maximum allowed size/.test(e.textContent))
        e.textContent = 'Save it smaller, or as JPEG: a file may have MEGABYTES MB at most.';
    });
  };
  label();
  new MutationObserver(label).observe(document.body, {childList: true, subtree: true});
}
"""
for name, text in (
    ("WORK", WORK_BUTTON),
    ("PHOTO", PHOTO_BUTTON),
    ("MEGABYTES", str(MOST_BYTES >> 20)),
):
    SCRIPT = SCRIPT.replace(name, text)

# The key of the page's session, by which a page that is loaded again goes on. The browser keeps it
# for this tab alone, and shows it to no other page; in the address it would be passed on with a
# link. A browser that may keep nothing throws an error at it; the page then works, but for being
# loaded again.
RECALL_KEY = """() => {
  try { return [sessionStorage.getItem('brdfactory-session') || ''] } catch { return [''] }
}"""
# If the session is the one that the page had, the tab that was open is opened again, and the
# photograph that was being analysed is analysed again.
KEEP_KEY = """key => {
  try {
    const before = sessionStorage.getItem('brdfactory-session');
    sessionStorage.setItem('brdfactory-session', key);
    const tab = sessionStorage.getItem('brdfactory-tab');
    const busy = sessionStorage.getItem('brdfactory-busy') === 'yes';
    sessionStorage.setItem('brdfactory-busy', 'no');
    if (before === key && busy)  // as soon as the button can be pressed
      setTimeout(() => document.querySelector('#decompose:enabled')?.click(), 500);
    if (before !== key) sessionStorage.setItem('brdfactory-tab', '1');
    else if (tab)
      [...document.querySelectorAll('[role=tab]')].find(e => e.innerText[0] === tab)?.click();
  } catch {}
}"""
