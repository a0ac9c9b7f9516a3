// A picture of what stands still, under the canvas on which the rest moves: drawn once, shown for as long as it holds.

export class Backdrop {
  private readonly picture = document.createElement("canvas");
  // Shows a finished picture; a canvas to draw on would be copied by the browser at every frame.
  private readonly context: ImageBitmapRenderingContext;
  /** how often it was made, for tests */
  made = 0;
  holds = false;

  constructor(canvas: HTMLCanvasElement) {
    this.picture.className = "backdrop";
    this.picture.ariaHidden = "true";
    this.picture.hidden = true;
    this.context = this.picture.getContext("bitmaprenderer")!;
    canvas.before(this.picture);
  }

  /** Keep what `canvas` shows now. */
  take(canvas: HTMLCanvasElement): void {
    const copy = new OffscreenCanvas(canvas.width, canvas.height);
    copy.getContext("2d")!.drawImage(canvas, 0, 0);
    this.context.transferFromImageBitmap(copy.transferToImageBitmap());
    this.picture.hidden = false;
    this.holds = true;
    this.made++;
  }

  /** It shows what is no longer so. */
  drop(): void {
    this.holds = false;
    if (!this.picture.hidden) this.picture.hidden = true;
  }
}
