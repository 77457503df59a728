// What pages do by themselves where a browser runs scripts; without it every page works by forms and reloading.
"use strict";

const each = (selector, act, root = document) => root.querySelectorAll(selector).forEach(act);

// Choosing is enough: a form with a select is sent when it changes.
each("select[data-now]", (select) => {
  const form = select.form;
  if (form.classList.contains("preferences")) form.querySelector("button").hidden = true;
  let before = select.value;
  const send = () => {
    if (select.value === before) return;
    before = select.value;
    const button = select.dataset.now && form.querySelector(`button[value="${select.dataset.now}"]`);
    form.requestSubmit(button || undefined);
  };
  // By the keyboard one moves through the list first.
  let byKeys = false;
  select.addEventListener("keydown", (event) => {
    byKeys = event.key !== "Enter";
    if (event.key === "Enter") send();
  });
  select.addEventListener("pointerdown", () => { byKeys = false; });
  select.addEventListener("change", () => { if (!byKeys) send(); });
  select.addEventListener("blur", send);
});

// Files: dropped or chosen, listed, refused if too large, and sent with a bar.
each("[data-drop]", (drop) => {
  const input = drop.querySelector("input"), list = drop.querySelector("ul");
  const pictures = /\.(png|jpe?g|bmp|tiff?)$/i;
  const show = () => {
    list.replaceChildren();
    let fault = "";
    for (const file of input.files) {
      const item = document.createElement("li");
      item.textContent = file.name;
      const most = Number(pictures.test(file.name) ? input.dataset.picture : input.dataset.most);
      if (file.size > most) {
        fault = input.dataset.large.replace("{name}", file.name).replace("{most}", String(Math.round(most / 1e6)));
        item.textContent = fault;
        item.className = "bad";
      }
      if (list.children.length < 30 || fault) list.append(item);
    }
    input.setCustomValidity(fault);
  };
  input.addEventListener("change", show);
  const stop = (event) => { event.preventDefault(); event.stopPropagation(); };
  let inside = 0;
  drop.addEventListener("dragenter", (event) => { stop(event); inside += 1; drop.classList.add("over"); });
  drop.addEventListener("dragover", stop);
  drop.addEventListener("dragleave", (event) => { stop(event); inside -= 1; if (!inside) drop.classList.remove("over"); });
  drop.addEventListener("drop", async (event) => {
    stop(event);
    inside = 0;
    drop.classList.remove("over");
    const all = new DataTransfer();
    for (const file of input.files) all.items.add(file);
    for (const file of await filesOf(event.dataTransfer)) all.items.add(file);
    input.files = all.files;
    show();
  });
  input.form.addEventListener("submit", (event) => {
    if (!input.files.length || event.defaultPrevented) return;
    event.preventDefault();
    upload(input.form, drop, input.dataset.sending);
  });
});
// A file that misses the frame must not replace the page.
for (const kind of ["dragover", "drop"]) window.addEventListener(kind, (event) => event.preventDefault());

// Dropped files, and those in dropped folders.
async function filesOf(dropped) {
  const entries = [...dropped.items].map((item) => item.webkitGetAsEntry && item.webkitGetAsEntry()).filter(Boolean);
  if (!entries.length) return [...dropped.files];
  const found = [];
  const visit = async (entry) => {
    if (entry.name.startsWith(".")) return;
    if (entry.isFile) {
      found.push(await new Promise((done, failed) => entry.file(done, failed)));
      return;
    }
    const reader = entry.createReader();
    for (;;) {
      const some = await new Promise((done, failed) => reader.readEntries(done, failed));
      if (!some.length) return;
      for (const one of some) await visit(one);
    }
  };
  for (const entry of entries) await visit(entry);
  return found;
}

function upload(form, drop, sending) {
  const request = new XMLHttpRequest(), bar = document.createElement("progress"), said = document.createElement("p");
  bar.max = 1;
  said.setAttribute("role", "status");
  drop.append(bar, said);
  each("button", (button) => { button.disabled = true; }, form);
  request.upload.addEventListener("progress", (event) => {
    if (!event.lengthComputable) return;
    bar.value = event.loaded / event.total;
    said.textContent = sending.replace("{percent}", String(Math.floor(100 * bar.value)));
  });
  request.addEventListener("load", () => {
    if (request.status < 300 && request.responseURL !== location.href) location.assign(request.responseURL);
    else if (request.status < 300) location.reload();
    else replacePage(request.responseText);
  });
  request.addEventListener("error", () => {
    bar.remove();
    said.textContent = "calib app: no answer.";
    each("button", (button) => { button.disabled = false; }, form);
  });
  request.open("POST", form.action);
  request.send(new FormData(form));
}

// The answer to what was refused, in the place of the page's content.
function replacePage(text) {
  const page = new DOMParser().parseFromString(text, "text/html"), content = page.querySelector("main");
  if (content) document.querySelector("main").replaceWith(content);
  else document.querySelector("main").textContent = text;
  document.querySelector("main").focus();
}

// Progress: the server's own lines, until the job is over.
each("[data-progress]", (place) => {
  const look = async () => {
    try {
      const answer = await fetch(place.dataset.progress, { cache: "no-store" });
      if (answer.headers.get("x-state") !== "running") {
        location.reload();
        return;
      }
      const text = await answer.text();
      if (place.dataset.shown !== text) place.innerHTML = place.dataset.shown = text;
    } catch {
      // The server is away; it may come back.
    }
    setTimeout(look, document.hidden ? 3000 : 500);
  };
  setTimeout(look, 300);
});

function offerCopies() {
  each("[data-copy][hidden]", (button) => {
    button.hidden = false;
    const before = button.textContent;
    button.addEventListener("click", async () => {
      await navigator.clipboard.writeText(document.getElementById(button.dataset.copy).textContent.trim());
      button.textContent = button.dataset.done;
      setTimeout(() => { button.textContent = before; }, 1500);
    });
  });
}
offerCopies();

each("[data-print]", (button) => {
  button.hidden = false;
  button.addEventListener("click", () => window.print());
});

// A table that is wider than the window says so.
each(".wide", (wide) => {
  const hint = document.createElement("p");
  hint.className = "scroll-hint screen";
  hint.textContent = document.body.dataset.scroll;
  hint.setAttribute("aria-hidden", "true");
  wide.before(hint);
  const look = () => { hint.hidden = wide.scrollWidth <= wide.clientWidth; };
  new ResizeObserver(look).observe(wide);
  look();
});

// A session: what other browsers and instruments add appears at once; what is being typed stays.
each("[data-live]", (sitting) => {
  const entry = document.getElementById("entry");
  const isTyping = () => entry && [...entry.querySelectorAll("input:not([type=hidden])")].some((input) => input.value);
  const look = async () => {
    try {
      const answer = await fetch(`${sitting.dataset.live}?v=${encodeURIComponent(sitting.dataset.version)}`, { cache: "no-store" });
      if (answer.status === 200 && answer.headers.get("x-paused")) {
        if (!isTyping()) {
          location.reload();
          return;
        }
      } else if (answer.status === 200 && !document.getElementById("live-top")) {
        location.reload();
        return;
      } else if (answer.status === 200) {
        const part = new DOMParser().parseFromString(await answer.text(), "text/html");
        const isOther = answer.headers.get("x-form") !== String(Boolean(entry));
        if (isOther && !isTyping()) {
          location.reload();
          return;
        }
        sitting.dataset.version = answer.headers.get("x-version");
        for (const id of ["live-top", "live-bottom"]) document.getElementById(id).replaceWith(part.getElementById(id));
        const pose = part.querySelector("input[name=pose]").value;
        each("iframe[data-at]", (frame) => { if (!frame.src.endsWith(pose)) frame.src = frame.dataset.at + pose; });
        // A reading that is being typed stays one of the pose that was shown.
        if (!isTyping()) each("input[name=pose]", (input) => { input.value = pose; }, sitting.querySelector(".now"));
        offerCopies();
        if (document.activeElement === document.body) each("button[data-first]", (button) => button.focus({ preventScroll: true }));
      }
    } catch {
      // The server is away; it may come back.
    }
    setTimeout(look, document.hidden ? 3000 : 700);
  };
  setTimeout(look, 700);
});

// One types at once; what is to be read first stays in sight.
each("[data-first]", (input) => input.focus({ preventScroll: true }));

// Numbers that were copied as one row fall into the fields of a reading one after the other.
each(".entry fieldset", (fields) => {
  fields.addEventListener("paste", (event) => {
    const words = event.clipboardData.getData("text").trim().split(/[;\t]\s*|\s+/).filter(Boolean);
    const inputs = [...fields.querySelectorAll("input")];
    if (words.length !== inputs.length) return;
    event.preventDefault();
    inputs.forEach((input, k) => { input.value = words[k]; });
    inputs[inputs.length - 1].focus();
  });
});

// A form is sent once.
document.addEventListener("submit", (event) => {
  const form = event.target;
  if (form.dataset.sent && !event.defaultPrevented) event.preventDefault();
  form.dataset.sent = "1";
  setTimeout(() => { delete form.dataset.sent; }, 3000);
});
