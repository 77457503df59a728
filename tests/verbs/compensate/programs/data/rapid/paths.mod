MODULE Paths (NOSTEPIN)
    CONST robtarget Target_10:=[[198.281,-82.5161,34.0199],[0.314474691,-0.244718181,-0.913300821,-0.084263227],[0,0,0,0],[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]];
    CONST robtarget Target_20 := [[355.0679,-26.4309,31.6213],[0.12472468,-0.391612558,-0.877133633,-0.248435],[0,0,0,0],[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]];
    CONST robtarget Target_30:=[[426.2181,26.6017,-26.656],[0.076697252,0.240770327,-0.967194882,0.02610061],[0,0,-1,0],[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]];
    PERS robtarget pVia := [[118.2012,-212.548,-32.8982],[0.284738858,-0.545655009,-0.750552115,-0.240532567],[-1,0,0,0],[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]];
    CONST robtarget pWeldStart:=[[-466.5179,-542.4775,86.8117],[0.363373568,-0.544676086,-0.739083601,-0.158249933],[-1,-1,-1,0],[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]];
    CONST robtarget pWeldEnd:=[[-469.7018,-473.1201,72.6623],[0.149114824,-0.8248375,-0.368754222,-0.401781274],[-1,0,0,0],[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]];
    CONST robtarget pSpot:=[[414.3675,449.2179,421.3194],[0.582664424,-0.491177173,0.183412556,-0.620972615],[0,-1,-2,1],[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]];
    CONST robtarget pGlue:=[[492.6303,132.9317,211.8689],[0.242340665,-0.138288628,-0.935553263,-0.216534867],[0,0,0,0],[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]];
    CONST robtarget pPaint:=[[534.686,104.6769,199.2765],[0.300014014,-0.651337828,-0.534569503,-0.447198024],[0,0,1,0],[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]];
    CONST robtarget pFind:=[[426.2181,26.6017,-26.656],[0.076697252,0.240770327,-0.967194882,0.02610061],[0,0,-1,0],[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]];
    CONST robtarget pNever:=[[400.125,-155.8259,336.9078],[0.006615892,-0.182508885,0.979806734,-0.081397178],[-1,-1,-1,0],[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]];
    CONST jointtarget jHome:=[[0,0,0,0,30,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
    CONST jointtarget jPark := [[0, -45, 30, 0, 60, 9E9],[9E9,9E9,9E9,9E9,9E9,9E9]];
    PERS tooldata tPen:=[TRUE,[[31.79,0,129.5],[0.945518576,0,0.325568154,0]],[1,[0,0,50],[1,0,0,0],0,0,0]];
    TASK PERS wobjdata wTable:=[FALSE,TRUE,"",[[100,-50,200],[0.9659258,0,0,0.2588190]],[[10,20,30],[1,0,0,0]]];
    TASK PERS tooldata tTorch := [TRUE, [[-20,15,200],[0.92387953,0,0.38268343,0]], [2.5,[10,0,90],[1,0,0,0],0,0,0.01]];
    PERS wobjdata wFix:=[FALSE,TRUE,"",[[-120.5,300.25,50],[0.70710678,0,0,0.70710678]],[[0,0,0],[1,0,0,0]]];
    VAR robtarget pFound;

    PROC Path_10()
        MoveAbsJ jHome\NoEOffs,v1000,fine,tPen;
        MoveJ Target_10,v1000,z100,tPen\WObj:=wTable;
        MoveL Target_20,v500,z10,tPen\WObj:=wTable\TLoad:=load0;
        MoveC pVia,Target_30,v500,fine,tPen\WObj:=wTable;
        MoveLDO Target_20,v500,z10,tPen\WObj:=wTable,doGlue,1;
        MoveJSync Target_10,v500,z10,tPen\WObj:=wTable,"Sync";
        MoveCDO pVia,Target_30,v500,z10,tPen\WObj:=wTable,doGlue,0;
        TriggL Target_20,v500,trigg1\T2:=trigg2,z10,tPen\WObj:=wTable;
        ArcLStart pWeldStart,v200,sm1,wd1\Weave:=wv1,fine,tTorch\WObj:=wFix;
        ArcLEnd pWeldEnd,v200,sm1,wd1,fine,tTorch\WObj:=wFix;
        SpotL pSpot,v500,spot1,tTorch;
        DispL \On,pGlue,v200,bead1,z10,tTorch;
        PaintL pPaint,v300,z10,tTorch;
        SearchL \Stop,diFound,pFound,pFind,v50,tPen\WObj:=wTable;
        MoveL pFound,v50,fine,tPen\WObj:=wTable;
        MoveAbsJ jPark,v1000,fine,tool0;
    ENDPROC
ENDMODULE
