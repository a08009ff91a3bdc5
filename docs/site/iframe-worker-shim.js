// Search in pages opened from disk, where a browser refuses to start a worker: the worker's script runs in a hidden frame.
if (location.protocol === "file:") {
  window.Worker = class extends EventTarget {
    constructor(url) {
      super();
      this.onmessage = null;
      this.waiting = [];
      const frame = document.createElement("iframe");
      frame.hidden = true;
      frame.srcdoc = "<!doctype html><title>search</title>";
      frame.onload = () => {
        const inner = frame.contentWindow;
        const listeners = [];
        inner.postMessage = (data) => this.answer(data);
        inner.addEventListener = (kind, listener) => kind === "message" && listeners.push(listener);
        inner.importScripts = (...urls) =>
          urls.reduce((before, each) => before.then(() => load(inner, each)), Promise.resolve());
        this.give = (data) => {
          const event = new MessageEvent("message", { data });
          for (const listener of [...listeners, inner.onmessage]) if (listener) listener.call(inner, event);
        };
        load(inner, new URL(url, location.href).href).then(() => {
          for (const data of this.waiting.splice(0)) this.give(data);
          this.ready = true;
        });
      };
      document.documentElement.append(frame);
    }
    postMessage(data) {
      if (this.ready) setTimeout(() => this.give(data));
      else this.waiting.push(data);
    }
    answer(data) {
      const event = new MessageEvent("message", { data });
      if (this.onmessage) this.onmessage(event);
      this.dispatchEvent(event);
    }
    terminate() {}
  };
  function load(inner, url) {
    return new Promise((done, failed) => {
      const script = inner.document.createElement("script");
      script.src = url;
      script.onload = done;
      script.onerror = failed;
      inner.document.head.append(script);
    });
  }
}
