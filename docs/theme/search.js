// Lets the search work in a page that was opened as a file.
//
// The search runs in a Web Worker, and browsers start none for a page at file://. There, this class
// takes the place of Worker. It runs the worker's script in a hidden frame, which has a global scope
// of its own, and passes the messages on.
class FrameWorker {
  constructor(url) {
    this.frame = document.createElement("iframe");
    this.frame.hidden = true;
    document.body.append(this.frame);
    this.scope = this.frame.contentWindow;
    this.scope.postMessage = (data) => this.onmessage?.({ data: structuredClone(data) });
    const script = this.scope.document.createElement("script");
    // Messages that come before the script has run wait for it.
    this.isReady = new Promise((resolve) => (script.onload = resolve));
    script.onerror = (event) => this.onerror?.(event);
    script.src = url;
    this.scope.document.body.append(script);
  }

  postMessage(data) {
    const message = { data: structuredClone(data) };
    this.isReady.then(() => this.scope.onmessage?.(message));
  }

  terminate() {
    this.frame.remove();
  }
}

if (location.protocol === "file:") window.Worker = FrameWorker;
