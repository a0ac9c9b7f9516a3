// Two stacked canvases: static content below, highlights that follow the pointer above.

export class Layers {
  readonly box = document.createElement("div");
  private readonly canvases = [document.createElement("canvas"), document.createElement("canvas")] as const;
  width = 0;
  height = 0;

  /** `redraw`: called after every change of size or theme. */
  constructor(className: string, redraw: () => void) {
    this.box.className = `layers ${className}`;
    for (const canvas of this.canvases) {
      canvas.ariaHidden = "true";
      this.box.append(canvas);
    }
    new ResizeObserver(() => {
      this.fit();
      redraw();
    }).observe(this.box);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
  }

  private fit(): void {
    const density = devicePixelRatio;
    [this.width, this.height] = [this.box.clientWidth, this.box.clientHeight];
    for (const canvas of this.canvases) {
      canvas.width = Math.round(this.width * density);
      canvas.height = Math.round(this.height * density);
    }
  }

  /** Clear a layer (0 below, 1 above), and return its context in CSS pixels. */
  clear(layer: 0 | 1): CanvasRenderingContext2D {
    const context = this.canvases[layer].getContext("2d")!;
    context.setTransform(devicePixelRatio, 0, 0, devicePixelRatio, 0, 0);
    context.clearRect(0, 0, this.width, this.height);
    context.font = `13px ${getComputedStyle(this.box).fontFamily}`;
    return context;
  }

  /** Context of the lower layer, without clearing it. */
  get below(): CanvasRenderingContext2D {
    return this.canvases[0].getContext("2d")!;
  }

  /** Position of a pointer event on the layers [CSS px]. */
  place({ clientX, clientY }: PointerEvent | MouseEvent): [number, number] {
    const { left, top } = this.box.getBoundingClientRect();
    return [clientX - left, clientY - top];
  }
}
