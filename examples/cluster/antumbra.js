// A job type for Flamenco 3 (https://flamenco.blender.org/usage/job-types/): an Antumbra command in shards, and a task
// that merges them. Put this file into the folder "scripts" next to flamenco-manager. Workers need the task type "misc".

const JOB_TYPE = {
    label: "Antumbra",
    description: "Exact ray-traced shadows: an Antumbra command in shards",
    settings: [
        { key: "folder", type: "string", subtype: "dir_path", required: true,
          description: "Working folder of the command, shared by all workers" },
        { key: "command", type: "string", required: true, default: "render scene.glb --preset final -o scene.png",
          description: "The words after 'antumbra', quoted as in a shell" },
        { key: "shards", type: "int32", required: true, default: 8, description: "Number of tasks" },
        { key: "shards_folder", type: "string", required: true, default: "scene.shards",
          description: "NAME.shards, where NAME is that of the output" },
    ],
};

function compileJob(job) {
    const settings = job.settings;
    const merge = shellTask("merge", settings.folder, `antumbra merge ${quoted(settings.shards_folder)}`);
    for (let i = 0; i < settings.shards; i++) {
        const words = `antumbra ${settings.command} --shard ${i}/${settings.shards}`;
        const shard = shellTask(`shard-${i}`, settings.folder, words);
        job.addTask(shard);
        merge.addDependency(shard);
    }
    job.addTask(merge);
}

function shellTask(name, folder, words) {
    const task = author.Task(name, "misc");
    task.addCommand(author.Command("exec", { exe: "sh", args: ["-c", `cd ${quoted(folder)} && ${words}`] }));
    return task;
}

function quoted(text) { // for a shell
    return "'" + text.replace(/'/g, "'\\''") + "'";
}
