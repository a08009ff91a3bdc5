"""What the page does in the browser, beside what Gradio does."""

from learn.app.object_tab import FIT_HELP, PHOTO_BUTTON, SHAPE_HELP, SHAPE_LABEL, WORK_BUTTON
from learn.app.opening import MOST_BYTES

# - asks before a page with a photograph is left, since it cannot be brought back, and tells the
#   server if the user stays (a timer runs only then)
# - asks before kept pictures give way to another photograph
# - takes a photograph that is dropped on the page or pasted, where a browser would show the file in
#   place of the page
# - moves the line between the photograph and its edit with arrow keys
# - moves a cross over the photograph with arrow keys, marks where it is, and draws lines with it
# - says aloud what changes; names pictures and what is drawn on
# - remembers which tab is open, and whether the photograph is being analysed, for the page that is
#   loaded again
CROSS_KEYS = (
    "Arrow keys move a cross, with Shift in larger steps. Enter marks what is under it as the"
    " object, Backspace marks it as background, Control Z undoes the last step. L sets the first"
    " corner of a line."
)
LINE_KEYS = (
    "L sets another corner, C closes the line around the object, P paints along it. Control Z"
    " removes the last corner, Escape all of them."
)
SCRIPT = """
() => {
  const find = selector => document.querySelector(selector);
  const isOpen = step => find(step)?.checkVisibility();
  addEventListener('beforeunload', event => {
    if (!find('#marking img')) return;
    event.preventDefault();
    setTimeout(() => find('#stayed').click(), 500);
  });

  const corners = [];  // of the line that the cross draws
  const removeLine = () => {
    corners.length = 0;
    drawCross();
  };
  const mayReplace = () => !find('#kept figure') ||
    confirm('The pictures that you kept to compare belong to the photograph that is open. They '
      + 'are lost if you open another one. Open another one?');
  addEventListener('click', event => {
    if (event.isTrusted && event.target.closest('#photo, #example, #work') && !mayReplace()) {
      event.preventDefault();
      event.stopImmediatePropagation();
    } else if (event.target.closest('#photo, #example, #work')) removeLine();
  }, true);

  const give = files => {
    if (!files.length || !isOpen('#step-1') || !mayReplace()) return;
    removeLine();
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

  // A cross that arrow keys move over the photograph takes the place of a mouse. Its place is a
  // share of the picture's width and height, since the picture changes its size with the window.
  const at = [0.5, 0.5];
  let speaking;
  const isPicture = e => e instanceof Element && e.matches('#marking button:has(img)');
  const shownRect = image => {  // of the picture inside its element, which may be wider or higher
    const r = image.getBoundingClientRect();
    const scale = Math.min(r.width / image.naturalWidth, r.height / image.naturalHeight);
    const [width, height] = [scale * image.naturalWidth, scale * image.naturalHeight];
    return [r.left + (r.width - width) / 2, r.top + (r.height - height) / 2, width, height];
  };
  const drawCross = () => {
    const image = find('#marking img'), cross = find('#cross');
    if (!image?.naturalWidth || !cross) return;
    const [left, top, width, height] = shownRect(image);
    const around = find('#marking').getBoundingClientRect();
    cross.style.left = `${left - around.left + at[0] * width}px`;
    cross.style.top = `${top - around.top + at[1] * height}px`;
    const onScreen = ([x, y]) => [left - around.left + x * width, top - around.top + y * height];
    const set = corners.map(onScreen).join(' '), last = corners.slice(-1).map(onScreen);
    const next = [...last, onScreen(at)].join(' ');
    find('#cross-path').innerHTML = corners.length ? `<polyline data-part="rim" points="${set}"/>
      <polyline data-part="core" points="${set}"/><polyline data-part="rim" points="${next}"/>
      <polyline data-part="next" points="${next}"/>` : '';
  };
  const showCross = () => {
    if (!find('#cross')) {
      const cross = document.createElement('div');
      cross.id = 'cross';
      cross.ariaHidden = 'true';
      const path = document.createElementNS('http://www.w3.org/2000/svg', 'svg');
      path.id = 'cross-path';
      path.ariaHidden = 'true';
      find('#marking').append(path, cross);
    }
    drawCross();
    find('#cross').hidden = false;
    find('#cross-path').style.display = '';
  };
  const placeText = () => {
    const [x, y] = at.map(share => Math.round(100 * share));
    return `Cross at ${x}% from the left, ${y}% from the top.`;
  };
  const sayPlace = text => {  // only once the keys rest, or each step would be read aloud
    clearTimeout(speaking);
    speaking = setTimeout(() => {
      const line = find('#cross-line');
      if (line) line.textContent = text;
    }, 250);
  };
  addEventListener('focusin', event => {
    if (!isPicture(event.target) || !event.target.matches(':focus-visible')) return;
    showCross();
    sayPlace(`${placeText()} CROSS_KEYS`);
  });
  addEventListener('focusout', event => {
    if (!isPicture(event.target) || !find('#cross')) return;
    find('#cross').hidden = true;
    find('#cross-path').style.display = 'none';
  });
  addEventListener('resize', drawCross);
  addEventListener('keydown', event => {
    if (!isPicture(event.target) || event.altKey || event.metaKey) return;
    const move = {ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1]};
    const adds = ['Enter', ' ', '+'].includes(event.key);
    const removes = ['Backspace', 'Delete', '-'].includes(event.key);
    const undoes = event.ctrlKey && event.key === 'z';
    const draws = ['l', 'c', 'p'].find(key => key === event.key.toLowerCase());
    const leaves = event.key === 'Escape' && corners.length;
    const known = adds || removes || draws || leaves || move[event.key];
    if (!undoes && (event.ctrlKey || !known)) return;
    event.preventDefault();
    if (undoes && !corners.length) return find('#undo').click();
    showCross();
    if (undoes || leaves) {
      corners.length = leaves ? 0 : corners.length - 1;
      drawCross();
      const left = corners.length === 1 ? '1 corner' : `${corners.length} corners`;
      return sayPlace(corners.length ? `The line has ${left} now.` : 'The line is removed.');
    }
    if (draws === 'l') {
      corners.push([...at]);
      drawCross();
      const keys = corners.length === 1 ? ' LINE_KEYS' : '';
      return sayPlace(`Corner ${corners.length}. ${placeText()}${keys}`);
    }
    if (draws) {
      const least = draws === 'c' ? 3 : 1;
      if (corners.length < least)
        return sayPlace(`Set ${least === 1 ? 'a corner' : 'three corners'} with L first.`);
      globalThis.brdfactoryPlace = JSON.stringify([corners, draws === 'c']);
      corners.length = 0;
      drawCross();
      return find('#outline').click();
    }
    if (adds || removes) {
      globalThis.brdfactoryPlace = JSON.stringify([at, adds]);
      return find('#point').click();
    }
    move[event.key].forEach((step, k) => {
      at[k] = Math.min(1, Math.max(0, at[k] + step * (event.shiftKey ? 0.1 : 0.01)));
    });
    drawCross();
    find('#cross').scrollIntoView({block: 'nearest', inline: 'nearest'});
    sayPlace(placeText());
  });

  addEventListener('pagehide', () => {
    const busy = find('#stop')?.checkVisibility() ? 'yes' : 'no';
    try { sessionStorage.setItem('brdfactory-busy', busy); } catch {}
  });

  const live = '#status, #shown, #progress, #improving, #made, #count';
  const names = [
    ['#marking img', 'alt', 'The photograph. A click on it marks the object.'],
    ['#marking button:has(img)', 'ariaLabel',
      'The photograph. A click on it marks the object. CROSS_KEYS'],
    // screen readers then pass the arrow keys on
    ['#marking:has(img)', 'role', 'application'],
    ['#marking:has(img)', 'ariaLabel', 'The photograph to mark the object in'],
    ['#fit input', 'ariaDescription', "FIT_HELP"],
    ['#shape', 'ariaLabel', "SHAPE_LABEL"],
    ['#shape', 'ariaDescription', "SHAPE_HELP"],
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
    ("CROSS_KEYS", CROSS_KEYS),
    ("FIT_HELP", FIT_HELP),
    ("LINE_KEYS", LINE_KEYS),
    ("SHAPE_HELP", SHAPE_HELP),
    ("SHAPE_LABEL", SHAPE_LABEL),
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
