// A picture of what stands still, under the canvas on which the rest moves: drawn once, shown for as long as it holds.

export class Backdrop {
  private readonly picture = document.createElement("canvas");
  private readonly context: CanvasRenderingContext2D;
  /** how often it was made, for tests */
  made = 0;
  holds = false;

  constructor(canvas: HTMLCanvasElement) {
    this.picture.className = "backdrop";
    this.picture.ariaHidden = "true";
    this.picture.hidden = true;
    this.context = this.picture.getContext("2d")!;
    canvas.before(this.picture);
  }

  /** Keep what `canvas` shows now. */
  take(canvas: HTMLCanvasElement): void {
    if (this.picture.width !== canvas.width) this.picture.width = canvas.width;
    if (this.picture.height !== canvas.height) this.picture.height = canvas.height;
    this.context.clearRect(0, 0, canvas.width, canvas.height);
    this.context.drawImage(canvas, 0, 0);
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
