// Aiming by pointer, touch, arrow keys or two numbers. The daemon decides whether it accepts the target.

import { $, number } from "./dom.js";

const STEP_M = 0.01;
const LARGE = 5; // times as far with shift

export class Aim {
  // reach({y_m, z_m}) sends a target.
  constructor(place, arm, reach) {
    this.arm = arm;
    this.reach = reach;
    this.place = place;
    this.inputs = { y_m: $("target-y"), z_m: $("target-z") };
    place.addEventListener("pointermove", (event) => event.pointerType === "mouse" && this.hover(event));
    place.addEventListener("pointerleave", () => this.arm.point(null));
    place.addEventListener("click", (event) => this.click(event));
    place.addEventListener("keydown", (event) => this.key(event));
    place.addEventListener("focus", () => place.matches(":focus-visible") && this.arm.point(this.typed()));
    place.addEventListener("blur", () => this.arm.point(null));
    for (const input of Object.values(this.inputs)) {
      input.addEventListener("input", () => this.arm.point(this.typed()));
      input.addEventListener("blur", () => this.arm.point(null));
    }
    $("target-form").addEventListener("submit", (event) => {
      event.preventDefault();
      this.reach({ y_m: this.inputs.y_m.valueAsNumber, z_m: this.inputs.z_m.valueAsNumber });
    });
  }

  // Return the point under the pointer in metres, or null below the plane and in perspective, where a drag turns the view.
  under(event) {
    if (this.arm.solid) return null;
    const box = this.arm.drawn.getBoundingClientRect();
    const size = this.arm.plane.width / box.width; // the browser may scale the drawing
    const [x, y] = [(event.clientX - box.left) * size, (event.clientY - box.top) * size];
    return y >= 0 && y <= this.arm.plane.bottom ? this.arm.plane.at(x, y) : null;
  }

  hover(event) {
    this.arm.point(this.under(event));
  }

  click(event) {
    const at = this.under(event);
    if (!at) return;
    this.write(at);
    this.arm.point(null); // the target's own mark replaces it
    this.reach(at);
  }

  typed() {
    const [y_m, z_m] = [this.inputs.y_m.valueAsNumber, this.inputs.z_m.valueAsNumber];
    return Number.isFinite(y_m) && Number.isFinite(z_m) ? { y_m, z_m } : null;
  }

  write({ y_m, z_m }) {
    this.inputs.y_m.value = y_m.toFixed(3);
    this.inputs.z_m.value = z_m.toFixed(3);
  }

  key(event) {
    const way = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key];
    const at = this.typed() ?? { y_m: 0, z_m: 0.6 };
    if (way) {
      const step = STEP_M * (event.shiftKey ? LARGE : 1);
      const next = { y_m: at.y_m + way[0] * step, z_m: at.z_m + way[1] * step };
      this.write(next);
      this.arm.point(next);
      this.place.setAttribute("aria-valuetext", `y ${number(next.y_m, 2)}, z ${number(next.z_m, 2)} m`);
    } else if (event.key === "Enter") {
      this.arm.point(null); // the target's own mark replaces it
      this.reach(at);
    } else if (event.key === "Escape") this.arm.point(null);
    else return;
    event.preventDefault();
  }
}
