// Pictures to click in: zoom by the wheel, pan by dragging, points that are dragged, a lens over the cursor; and films
// that are played with their tracks. Python hears `vs_click`, `vs_drag` and nothing of what happens in between.
(() => {
  const NEAR_PX = 12, STILL_PX = 4, LENS = 21, FAR = 40;
  const frames = new WeakMap();

  const parts = (frame) => {
    if (!frames.has(frame)) frames.set(frame, { zoom: 1 });
    return frames.get(frame);
  };
  const size = (frame) => [Number(frame.dataset.width), Number(frame.dataset.height)];
  // The centre of the first pixel is (0, 0).
  const pixel = (frame, event) => {
    const box = frame.querySelector("img").getBoundingClientRect(), [width, height] = size(frame);
    return [
      ((event.clientX - box.left) / box.width) * width - 0.5,
      ((event.clientY - box.top) / box.height) * height - 0.5,
    ];
  };
  const inside = (frame, [u, v]) => {
    const [width, height] = size(frame);
    return u >= 0 && v >= 0 && u <= width - 1 && v <= height - 1;
  };
  const rescale = (frame) => {
    const sheet = frame.querySelector(".vs-sheet"), shown = sheet.getBoundingClientRect().width || 1;
    sheet.style.setProperty("--vs-k", size(frame)[0] / shown);
    sheet.classList.toggle("vs-near", shown > 2 * size(frame)[0]);
  };
  const zoom = (frame, factor, x, y) => {
    const state = parts(frame), sheet = frame.querySelector(".vs-sheet"), box = frame.getBoundingClientRect();
    const most = (FAR * size(frame)[0]) / box.width;
    const next = Math.min(Math.max(state.zoom * factor, 1), Math.max(most, 1));
    const left = x - box.left + frame.scrollLeft, top = y - box.top + frame.scrollTop;
    sheet.style.width = `${100 * next}%`;
    frame.scrollLeft = (left * next) / state.zoom - (x - box.left);
    frame.scrollTop = (top * next) / state.zoom - (y - box.top);
    state.zoom = next;
    rescale(frame);
  };
  const nearest = (frame, event) => {
    let best = null, least = NEAR_PX;
    for (const mark of frame.querySelectorAll(".vs-point .vs-mark")) {
      const box = mark.getBoundingClientRect();
      const away = Math.hypot(box.left + box.width / 2 - event.clientX, box.top + box.height / 2 - event.clientY);
      if (away <= least) [best, least] = [mark.closest(".vs-point"), away];
    }
    return best;
  };
  const look = (frame, event) => {
    const lens = frame.parentElement.querySelector(".vs-lens"), read = frame.parentElement.querySelector(".vs-read");
    const at = pixel(frame, event), image = frame.querySelector("img");
    if (!lens || !inside(frame, at)) {
      if (lens) lens.style.display = "none";
      return;
    }
    if (read) read.textContent = `(${at[0].toFixed(1)}, ${at[1].toFixed(1)})`;
    const box = frame.getBoundingClientRect(), context = lens.getContext("2d");
    const right = event.clientX - box.left < box.width / 2;
    lens.style.display = "block";
    lens.style.left = right ? `${frame.offsetLeft + box.width - 190}px` : `${frame.offsetLeft + 4}px`;
    lens.style.top = `${frame.offsetTop + 4}px`;
    context.imageSmoothingEnabled = false;
    context.fillStyle = "#000";
    context.fillRect(0, 0, lens.width, lens.height);
    const scale = image.naturalWidth / size(frame)[0], side = LENS * scale;
    context.drawImage(image, (at[0] + 0.5) * scale - side / 2, (at[1] + 0.5) * scale - side / 2, side, side,
      0, 0, lens.width, lens.height);
    context.strokeStyle = "#ff9800";
    context.beginPath();
    context.moveTo(lens.width / 2, 0); context.lineTo(lens.width / 2, lens.height);
    context.moveTo(0, lens.height / 2); context.lineTo(lens.width, lens.height / 2);
    context.stroke();
  };

  // Heard by the step that holds the picture, and gone with it.
  const tell = (frame, what, detail) => frame.dispatchEvent(new CustomEvent(what, { bubbles: true, detail }));

  let held = null;
  document.addEventListener("wheel", (event) => {
    const frame = event.target.closest?.(".vs-frame");
    if (!frame) return;
    event.preventDefault();
    zoom(frame, event.deltaY < 0 ? 1.25 : 0.8, event.clientX, event.clientY);
  }, { passive: false });
  document.addEventListener("pointerdown", (event) => {
    const frame = event.target.closest?.(".vs-frame");
    if (!frame || event.button !== 0) return;
    event.preventDefault();
    const point = nearest(frame, event);
    held = { frame, point, x: event.clientX, y: event.clientY, left: frame.scrollLeft, top: frame.scrollTop };
  });
  document.addEventListener("pointermove", (event) => {
    const frame = event.target.closest?.(".vs-frame");
    if (frame) look(frame, event);
    else for (const lens of document.querySelectorAll(".vs-lens")) lens.style.display = "none";
    if (!held) return;
    if (held.point) {
      const k = size(held.frame)[0] / held.frame.querySelector("img").getBoundingClientRect().width;
      held.point.setAttribute("transform", `translate(${(event.clientX - held.x) * k} ${(event.clientY - held.y) * k})`);
    } else {
      held.frame.scrollLeft = held.left - (event.clientX - held.x);
      held.frame.scrollTop = held.top - (event.clientY - held.y);
    }
  });
  document.addEventListener("pointerup", (event) => {
    if (!held) return;
    const { frame, point, x, y } = held, away = Math.hypot(event.clientX - x, event.clientY - y), view = frame.dataset.view;
    held = null;
    const at = pixel(frame, event);
    if (point && away <= STILL_PX) tell(frame, "vs_pick", { view, point: point.dataset.point });
    else if (point && inside(frame, at)) {
      // The point goes as far as the cursor did: nobody takes it at its centre.
      const from = pixel(frame, { clientX: x, clientY: y });
      tell(frame, "vs_drag", { view, point: point.dataset.point, u: at[0] - from[0], v: at[1] - from[1] });
    } else if (point) point.removeAttribute("transform");
    else if (away <= STILL_PX && inside(frame, at)) tell(frame, "vs_click", { view, u: at[0], v: at[1] });
  });
  new ResizeObserver(() => document.querySelectorAll(".vs-frame").forEach(rescale)).observe(document.documentElement);
  new MutationObserver(() => document.querySelectorAll(".vs-frame").forEach(rescale)).observe(document.documentElement,
    { childList: true, subtree: true });

  // A film with its tracks: one picture after the other, as fast as they come.
  const films = {};
  const frame = (film) => film.url.replace("{}", film.tracks.numbers[film.at]);
  const draw = (film, at) => {
    const canvas = film.box.querySelector("canvas"), image = film.box.querySelector("img"), tracks = film.tracks;
    [canvas.width, canvas.height] = [image.naturalWidth, image.naturalHeight];
    const context = canvas.getContext("2d"), unit = Math.max(canvas.width / 900, 1);
    context.lineWidth = 2 * unit;
    context.font = `${14 * unit}px sans-serif`;
    tracks.points.forEach((name, row) => {
      const here = tracks.position[at]?.[row], home = tracks.home[row];
      if (!here || here[0] === null || home[0] === null) return;
      const tip = [0, 1].map((one) => home[one] + 0.5 + film.times * (here[one] - home[one]));
      context.strokeStyle = context.fillStyle = tracks.static[row] ? "#4fc3f7" : "#ffb300";
      context.beginPath();
      context.moveTo(here[0] + 0.5 + 5 * unit, here[1] + 0.5);
      context.arc(here[0] + 0.5, here[1] + 0.5, 5 * unit, 0, 2 * Math.PI);
      context.moveTo(home[0] + 0.5, home[1] + 0.5);
      context.lineTo(...tip);
      context.stroke();
      context.fillText(name, home[0] + 8 * unit, home[1] - 8 * unit);
    });
  };
  window.vsFilm = (id, url, tracks, times) => {
    const box = document.getElementById(id);
    if (!box) return;
    const film = (films[id] = { box, url, tracks, times, at: 0, plays: false });
    const image = box.querySelector("img");
    image.onload = () => {
      draw(film, film.at);
      if (film.plays && document.body.contains(box)) {
        film.at = (film.at + 1) % tracks.numbers.length;
        setTimeout(() => (image.src = frame(film)), 20);
      }
    };
    image.src = frame(film);
  };
  window.vsPlay = (id, plays) => {
    const film = films[id];
    film.plays = plays;
    film.box.querySelector("img").src = `${frame(film)}&again=${Date.now()}`;
  };
  window.vsTimes = (id, times) => { films[id].times = times; draw(films[id], films[id].at); };
})();
