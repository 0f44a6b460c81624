// An environment whose second mask leaves the second int of an action no legal value.
import gluerl.*;

class Walker implements Environment {
    public String init() { return "TASK_SPEC"; }
    public Observation start() { return masked(true); }
    public Step step(Action action) { return new Step(0, false, masked(false)); }

    static Observation masked(boolean somewhere) {
        return new Observation(0).withMask(false, true, false, somewhere, false);
    }

    public static void main(String[] args) {
        Glue.serve(new Walker(), Options.named("nowhere"));
    }
}
